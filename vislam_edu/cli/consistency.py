"""`python -m vislam_edu consistency`: the filters over many simulated drives: are their covariances honest?"""

import functools
import json
from pathlib import Path

from .arguments import OptionError, add_noise, sigmas, whole


def add_arguments(parser):
    """The options of `consistency`. parser : argparse.ArgumentParser."""
    parser.add_argument("--seeds", type=whole(1, 100_000), default=50, help="number of drives (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="directory for summary.json and a file "
                        "per drive; a study that was interrupted goes on from there")
    parser.add_argument("--frames", type=whole(2, 100_000), help="frames per drive (default: 500, or a regime's own)")
    parser.add_argument("--regime", metavar="NAME", help="filters and batch where cameras, rates, noise or distances "
                        "are others, see studies.regimes (far, robot, slow, ...), or all of them")
    add_noise(parser)
    parser.add_argument("--workers", type=whole(1, 1024), default=1, help="processes (default: %(default)s)")


def run(arguments) -> int:
    """Run the study on the default simulated drive or on regimes, print its table, write its summary.

    Returns the exit status. Raises OptionError when no such drive can be made, for an unknown regime, or when the
    directory holds another study.
    """
    if arguments.regime:
        return run_regimes(arguments)
    import joblib

    from .. import simulate
    from ..noise import Noise
    from ..recordings import files
    from ..studies import consistency

    sensors = sigmas(arguments)
    make_drive = functools.partial(simulate.street_loop, frames=arguments.frames or 500, **sensors)
    try:
        with files.made_folder(arguments.out), joblib.parallel_config(n_jobs=arguments.workers):
            studies = consistency.monte_carlo(make_drive, consistency.standard_filters(Noise(**sensors)),
                                              range(arguments.seeds), arguments.out)
    except ValueError as error:
        raise OptionError(f"consistency: {error}") from None
    figures = consistency.summary(studies) | sensors
    files.write_text(arguments.out / "summary.json", json.dumps(figures, indent=2) + "\n")
    print(consistency.format_summary(figures))
    return 0


def run_regimes(arguments) -> int:
    """Run the regimes asked for and print a line for each filter; the summary is written anew after every regime.

    A regime has its own noise: the options of noise belong to the default drive.
    """
    import joblib

    from ..recordings import files
    from ..studies import regimes

    names = list(regimes.REGIMES) if arguments.regime == "all" else [arguments.regime]
    if unknown := set(names) - set(regimes.REGIMES):
        raise OptionError(f"consistency --regime: {unknown.pop()!r} is not one of all, {', '.join(regimes.REGIMES)}")
    options = {"frames": arguments.frames} if arguments.frames else {}
    found: dict[str, dict] = {}
    for name in names:
        try:
            with files.made_folder(arguments.out), joblib.parallel_config(n_jobs=arguments.workers):
                found[name] = regimes.study(name, range(arguments.seeds), **options)
        except ValueError as error:
            raise OptionError(f"consistency --regime {name}: {error}") from None
        files.write_text(arguments.out / "summary.json", json.dumps({"regimes": found}, indent=2) + "\n")
        print(regimes.format_study(name, found[name]))
    return 0
