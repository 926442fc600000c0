"""Monte Carlo: does the truth lie where the filter says it does, drive after drive?

One drive proves nothing, for a good filter is unlucky at times. So many drives are simulated, each with its own seed;
the same filters run over each; and the squared errors are held against what the filters claimed.

    make_drive = functools.partial(simulate.street_loop, frames=200)
    studies = monte_carlo(make_drive, standard_filters(Noise()), range(50), out="study")
    summary(studies)["right_invariant"]["nees_pose"]

With `out`, every drive leaves a file, and a study that was interrupted goes on where it stopped. The
numbers depend on the seeds alone, not on the workers: every random draw comes from the seed, and
`window_slam.run` keeps the linear algebra to one thread. docs/commands.md says how to use several cores, or a cluster.
"""

from dataclasses import dataclass, field
from pathlib import Path

import joblib
import numpy as np
from tqdm.auto import tqdm

from .. import metrics, se3, window_slam
from ..drive import DriveError
from ..error_state import ErrorState, InverseDepth, RightInvariant, RightPerturbation
from ..noise import Noise
from ..recordings import files
from .runs import record

_START = 100  # the stream of a seed that draws the filter's initial pose; simulate uses the first few


@dataclass(frozen=True, eq=False)
class FilterConfig:
    """A joint filter to be judged: what it believes of the sensors, its error state, options of `window_slam.run`."""

    noise: Noise
    error_state: ErrorState
    options: dict = field(default_factory=dict)


def standard_filters(noise):
    """The five filters of the study by name, each one step further from the report's. noise : what the sensors have.

    report_values       the report's W, V and Sigma_0, its error and its new landmarks
    report              the same with the noise the sensors have
    right_perturbation  and with new landmarks that are correlated with the pose
    right_invariant     and with the right-invariant error
    inverse_depth       and with landmarks of inverse depth
    """
    as_report = {"process_frame": window_slam.as_report}
    return {"report_values": FilterConfig(Noise.from_report(), RightPerturbation(), as_report),
            "report": FilterConfig(noise, RightPerturbation(), as_report),
            "right_perturbation": FilterConfig(noise, RightPerturbation()),
            "right_invariant": FilterConfig(noise, RightInvariant()),
            "inverse_depth": FilterConfig(noise, InverseDepth())}


@dataclass(frozen=True, eq=False)
class Study:
    """What one filter did over N drives of T frames.

    seeds : (N,). nees_pose, nees_rotation, nees_position : (N, T), see `metrics.pose_nees`.
    nis : (N,) mean NIS of one measurement.
    error : (N, T) m, distance of the estimated from the true position, both seen from frame 0: the drift, which is what
    the sensors can tell. error_world : (N, T) m, the same in the world, the error of the initial pose included.
    """

    seeds: np.ndarray
    nees_pose: np.ndarray
    nees_rotation: np.ndarray
    nees_position: np.ndarray
    nis: np.ndarray
    error: np.ndarray
    error_world: np.ndarray


_FIELDS = ("nees_pose", "nees_rotation", "nees_position", "nis", "error", "error_world")


def judge(drive, candidate, world_T_imu):
    """Run one filter over one drive from a given initial pose; a dict of the fields of `Study` for this run.

    drive : Drive with truth. candidate : FilterConfig. world_T_imu : (4, 4).
    """
    true = drive.true_world_T_imu
    run = record(window_slam.run(drive, candidate.noise, candidate.error_state, world_T_imu=world_T_imu,
                                 **candidate.options), candidate.error_state)
    nees = metrics.pose_nees(candidate.error_state, true, run.world_T_imu, run.covariance)
    from_start = [se3.inverse(poses[0]) @ poses for poses in (true, run.world_T_imu)]
    return {"nees_pose": nees.pose, "nees_rotation": nees.rotation, "nees_position": nees.position,
            "nis": run.mean_nis, "error": metrics.position_errors(*from_start), "error_world": run.errors(true)}


def initial_pose(drive, candidate, seed):
    """(4, 4): where the filter believes to start: off the truth by a draw from its own covariance.

    A filter that started at the truth, yet claimed to be uncertain of it, would look better than it is.
    The same seed draws the same pose for every filter with this covariance.
    """
    rng = np.random.default_rng((seed, _START))
    error = rng.multivariate_normal(np.zeros(6), candidate.noise.initial_pose_covariance)
    nobody = np.empty((0, *candidate.error_state.point_shape))
    return candidate.error_state.retract(drive.true_world_T_imu[0], nobody, -error)[0]


def _one_seed(make_drive, filters, seed, path, study):
    """All filters over the drive of one seed, {name: fields of `Study`}; from its file if there is one."""
    if path is not None and path.exists():
        return _load(path, filters, study)
    drive = make_drive(seed)
    runs = {name: judge(drive, candidate, initial_pose(drive, candidate, seed)) for name, candidate in filters.items()}
    if path is not None:
        with files.replacing(path) as file:
            np.savez(file, study=study, **{f"{name}.{key}": value
                                           for name, run in runs.items() for key, value in run.items()})
    return runs


def _load(path, filters, study):
    with files.errors_name(path), files.open_fields(path) as file:
        if file.text("study") != study:
            raise ValueError(f"{path} belongs to a study of other drives or filters: "
                             "give another directory, or delete this one")
        runs = {name: {key: file.numbers(f"{name}.{key}") for key in _FIELDS} for name in filters}
        frames = next(iter(runs.values()))["error"].size
        for name, run in runs.items():
            for key, values in run.items():
                shape = () if key == "nis" else (frames,)
                if (values.dtype, values.shape) != (float, shape) or not (np.abs(values) < 1e100).all():
                    raise DriveError(f"{name}.{key}: not as the study wrote it: delete this file")
        return runs


def monte_carlo(make_drive, filters, seeds, out=None):
    """Run filters side by side over simulated drives, in parallel where `joblib.parallel_config` says so.

    make_drive : seed -> Drive with truth, all of one length; a function that a worker can import, or a
    functools.partial of one. filters : {name: FilterConfig}. seeds : iterable of int.
    out : directory for one file per seed, made if need be; files of the same study that it holds are not run again.
    Returns {name: Study}.
    Raises ValueError when `out` holds runs of another study: what counts are make_drive, its arguments and
    the filters. A change of the package's own code is not noticed; take a new directory then.
    """
    seeds = [int(seed) for seed in seeds]
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds must be at least one, and all different, got {seeds}")
    study = joblib.hash((make_drive, filters))
    paths: list[Path | None] = [None] * len(seeds)
    if out is not None:
        Path(out).mkdir(parents=True, exist_ok=True)
        paths = [Path(out) / f"seed_{seed:05d}.npz" for seed in seeds]
    results = joblib.Parallel(return_as="generator")(
        joblib.delayed(_one_seed)(make_drive, filters, seed, path, study) for seed, path in zip(seeds, paths))
    runs = list(tqdm(results, total=len(seeds), desc="drives", unit="drive"))
    return {name: Study(np.array(seeds), *(np.array([run[name][key] for run in runs]) for key in _FIELDS))
            for name in filters}


def summary(studies) -> dict:
    """The study in figures, as written to summary.json: per filter, means over all runs and frames.

    nees_pose, nees_rotation, nees_position   6, 3 and 3 are right
    nees_pose_standard_error                  of nees_pose, from the scatter of the N means over a run
    frames_in_band                            share of frames whose mean over runs lies in band_99
    nis                                       of one stereo measurement, 4 is right: the median over the runs of
                                              their means, since one measurement of a landmark whose depth is less
                                              certain than it is long can be worth thousands
    rmse_m, rmse_world_m                      RMS of `Study.error` and `Study.error_world`

    and for all of them runs, frames, band_99 (pose) and band_99_3_dof (rotation or position): where 99 % of the means
    over N runs lie at any one frame if the filter is honest, see `metrics.chi2_band`. An honest filter's mean over the
    frames as well lies there more often than 99 % of the time, since errors change along a drive.
    """
    first = next(iter(studies.values()))
    runs, frames = first.nees_pose.shape
    band = metrics.chi2_band(6, runs)
    figures = {name: _figures(study, band) for name, study in studies.items()}
    return figures | {"runs": runs, "frames": frames, "band_99": list(band),
                      "band_99_3_dof": list(metrics.chi2_band(3, runs))}


def _figures(study, band) -> dict:
    runs = len(study.seeds)
    over_runs = study.nees_pose.mean(axis=0)
    of_runs = study.nees_pose.mean(axis=1)
    return {"nees_pose": float(of_runs.mean()),
            "nees_pose_standard_error": float(of_runs.std(ddof=1) / np.sqrt(runs)) if runs > 1 else None,
            "frames_in_band": float(np.mean((band[0] <= over_runs) & (over_runs <= band[1]))),
            "nees_rotation": float(study.nees_rotation.mean()),
            "nees_position": float(study.nees_position.mean()),
            "nis": float(np.median(study.nis)),
            "rmse_m": float(np.sqrt(np.mean(study.error**2))),
            "rmse_world_m": float(np.sqrt(np.mean(study.error_world**2)))}


def format_summary(figures) -> str:
    """The summary as text, one line per filter."""
    columns = {"nees_pose": "NEES pose", "nees_rotation": "rotation", "nees_position": "position",
               "nis": "NIS", "rmse_m": "RMSE m", "rmse_world_m": "in world"}
    names = [name for name, value in figures.items() if isinstance(value, dict)]
    width = max(map(len, names))
    lines = [" " * width + "".join(f"{title:>11}" for title in columns.values())]
    lines += [f"{name:{width}}" + "".join(f"{_digits(figures[name][key]):>11}" for key in columns) for name in names]
    low, high = figures["band_99"]
    lines.append(f"{figures['runs']} drives of {figures['frames']} frames; "
                 f"99 % band of the pose's NEES [{low:.2f}, {high:.2f}]")
    return "\n".join(lines)


def _digits(value) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.2f}"
