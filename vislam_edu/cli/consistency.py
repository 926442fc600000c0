"""`python -m vislam_edu consistency`: the filters over many simulated drives: are their covariances honest?"""

import functools
import json
from pathlib import Path

from ..noise import Noise
from .arguments import OptionError, number, whole


def add_arguments(parser):
    """The options of `consistency`. parser : argparse.ArgumentParser."""
    noise = Noise()
    parser.add_argument("--seeds", type=whole(1, 100_000), default=50, help="number of drives (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="directory for summary.json and a file "
                        "per drive; a study that was interrupted goes on from there")
    parser.add_argument("--frames", type=whole(2, 100_000), default=500, help="frames per drive (default: %(default)s)")
    parser.add_argument("--sigma-v", type=number(0, 1e3), default=noise.sigma_v, help="m/s (default: %(default)s)")
    parser.add_argument("--sigma-omega", type=number(0, 1e2), default=noise.sigma_omega,
                        help="rad/s (default: %(default)s)")
    parser.add_argument("--sigma-px", type=number(0, 1e3, low_allowed=False), default=noise.sigma_px,
                        help="px (default: %(default)s)")
    parser.add_argument("--workers", type=whole(1, 1024), default=1, help="processes (default: %(default)s)")


def run(arguments) -> int:
    """Run the study on the default simulated drive, print its table, write its summary; returns the exit status.

    Raises OptionError when no such drive can be made, or when the directory holds another study.
    """
    import joblib

    from .. import simulate
    from ..recordings.files import replacing
    from ..studies import consistency

    sensors = {key: getattr(arguments, key) for key in ("sigma_v", "sigma_omega", "sigma_px")}
    make_drive = functools.partial(simulate.street_loop, frames=arguments.frames, **sensors)
    try:
        with joblib.parallel_config(n_jobs=arguments.workers):
            studies = consistency.monte_carlo(make_drive, consistency.standard_filters(Noise(**sensors)),
                                              range(arguments.seeds), arguments.out)
    except ValueError as error:
        raise OptionError(f"consistency: {error}") from None
    figures = consistency.summary(studies) | sensors
    with replacing(arguments.out / "summary.json") as file:
        file.write((json.dumps(figures, indent=2) + "\n").encode())
    print(consistency.format_summary(figures))
    return 0
