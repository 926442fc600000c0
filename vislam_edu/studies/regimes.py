"""Where does a filter hold? The same filters over drives of many kinds: cameras, rates, noise, distances.

    drive, noise = REGIMES["far"](seed=0)
    figures = study("far", range(10))
    figures["filters"]["inverse_depth"]["nees_pose"]

Every regime is a function from a seed to a simulated drive and the noise its sensors really have, so a filter that is
not honest there has only itself to blame. Keyword arguments of a regime replace its own, `frames` for one.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import joblib
import numpy as np
from tqdm.auto import tqdm

from .. import batch, metrics, odometry, se3, simulate
from ..drive import Drive, DriveError
from ..error_state import ErrorState, InverseDepth, RightInvariant, RightPerturbation
from ..noise import Noise
from ..stereo import StereoCamera
from . import consistency, pipeline, run_warnings
from .runs import against_truth

Regime = Callable[..., tuple[Drive, Noise]]
FILTERS: dict[str, ErrorState] = {"inverse_depth": InverseDepth(), "cartesian": RightInvariant(),
                                  "right": RightPerturbation()}


def on_street(seed: int, *, sigma_v: float = 0.5, sigma_omega: float = 0.05, sigma_px: float = 0.7, frames: int = 300,
              **geometry) -> tuple[Drive, Noise]:
    """A street and its noise. The sigmas are those of `Noise`; geometry : of `simulate.street_loop`."""
    noise = Noise(sigma_v, sigma_omega, sigma_px)
    return simulate.street_loop(seed, frames=frames, sigma_v=sigma_v, sigma_omega=sigma_omega, sigma_px=sigma_px,
                                **geometry), noise


def on_the_spot(seed: int, *, yaw_rate: float = 0.0, frames: int = 300) -> tuple[Drive, Noise]:
    """A car that does not move, or turns where it stands. yaw_rate : rad/s."""
    times = 0.1 * np.arange(frames)
    world_T_imu = se3.exp(np.outer(times, [0, 0, 0, 0, 0, yaw_rate]))
    return simulate.add_noise(simulate.along(world_T_imu, times, seed), seed), Noise()


def with_gaps(seed: int, *, frames: int = 300, blind: Sequence[tuple[float, float]] = ((0, 0.1), (0.4, 0.5)),
              ) -> tuple[Drive, Noise]:
    """A street whose cameras see nothing for some time. blind : (from, to), shares of the drive."""
    drive, noise = on_street(seed, frames=frames)
    seen = np.ones(len(drive.pixels), dtype=bool)
    for begin, end in (np.round(np.multiply(each, frames)) for each in blind):
        lost = drive.first_seen[drive.landmark] < end  # what was in view before does not come back
        seen &= (drive.frame < begin) | ((drive.frame >= end) & ~lost)
    return drive.keep_observations(seen), noise


def _camera(f: Sequence[float] = (720.0, 720.0), baseline: float = 0.54, forward: float = 1.1) -> StereoCamera:
    """KITTI's with other focal lengths (px), another baseline (m) or place (m ahead of the IMU)."""
    kitti = simulate.kitti_camera()
    imu_T_cam = kitti.imu_T_cam.copy()
    imu_T_cam[0, 3] = forward
    K = np.array([[f[0], 0, 610.0], [0, f[1], 173.0], [0, 0, 1]])
    return replace(kitti, K=K, baseline=baseline, cam_T_imu=se3.inverse(imu_T_cam))


_robot_eye = replace(_camera(baseline=0.096, forward=0.2), K=np.array([[377.0, 0, 336], [0, 377, 188], [0, 0, 1]]))

REGIMES: dict[str, Regime] = {
    "street": on_street,
    "far": partial(on_street, depth=(60.0, 250.0)),
    "few": partial(on_street, visible=6),
    "one": partial(on_street, visible=1),
    "quiet": partial(on_street, sigma_v=0.02, sigma_omega=0.002),
    "standing": on_the_spot,
    "turning": partial(on_the_spot, yaw_rate=0.2),
    "noisy": partial(on_street, sigma_px=3.0),
    "jitter": partial(on_street, jitter=0.045, camera=_camera(f=(720.0, 600.0))),
    "lever": partial(on_street, camera=_camera(forward=6.0)),
    "long_baseline": partial(on_street, camera=_camera(baseline=5.0)),
    "short_baseline": partial(on_street, camera=_camera(baseline=0.05)),
    "fast": partial(on_street, tau=0.005, jitter=0.0, mean_life=600.0, life=(20, 2000), redetect_every=60, frames=600),
    "slow": partial(on_street, tau=1.0, speed=5.0, life=(2, 30), mean_life=10.0, redetect_every=1),
    "gaps": with_gaps,
    "robot": partial(on_street, tau=1 / 30, speed=1.5, depth=(1.0, 30.0), nearest=0.5, sigma_v=0.1, sigma_omega=0.01,
                     camera=_robot_eye, image_size=(672, 376), mean_life=100.0, life=(5, 300)),
    "long": partial(on_street, speed=20.0, visible=30, frames=5000),  # 10 km
}


def judge(regime: str, seed: int, names: Sequence[str] = (*FILTERS, "batch"), **options) -> dict[str, dict]:
    """The filters of these names over one drive of a regime: name: the figures of this run, see `study`.

    Each starts off the truth by the same draw from the covariance it claims. options : of the regime, such as frames.
    """
    drive, noise = REGIMES[regime](seed, **options)
    start = consistency.initial_pose(drive, consistency.FilterConfig(noise, RightInvariant()), seed)
    dead_reckoning = odometry.dead_reckon(drive, noise, start)
    found, path = {}, dead_reckoning.world_T_imu
    for name, error_state in FILTERS.items():
        if name in names:
            slam = pipeline.joint(drive, noise, error_state, world_T_imu=start)
            warnings = run_warnings.of_filter(drive, slam, dead_reckoning, 0.99, drive.true_world_T_imu)
            found[name] = _figures(drive, slam.trajectory.world_T_imu, slam.trajectory.covariance, slice(None),
                                   slam.rejected_share, warnings)
            path = slam.trajectory.world_T_imu if name == "inverse_depth" else path
    if "batch" in names:
        smoothed = pipeline.run_batch(batch.Problem(drive, noise, prior_world_T_imu=start), path)
        frames, covariance = smoothed.claims
        found["batch"] = _figures(drive, smoothed.solution.estimate.world_T_imu, covariance, frames, 0.0,
                                  run_warnings.of_batch(smoothed, drive.true_world_T_imu))
    return found


def _figures(drive, world_T_imu, covariance, frames, rejected_share, warnings) -> dict:
    true = drive.true_world_T_imu
    nees, _ = against_truth(true[frames], world_T_imu[frames], covariance)
    drift = metrics.position_errors(*(se3.inverse(poses[0]) @ poses for poses in (true, world_T_imu)))
    return {"nees_pose": nees, "rmse_m": float(np.sqrt(np.mean(drift**2))),
            "rejected_share": rejected_share, "warnings": warnings}


def _attempt(regime, seed, names, options) -> dict[str, dict]:
    try:
        return judge(regime, seed, names, **options)
    except (np.linalg.LinAlgError, DriveError) as error:
        return {name: {"warnings": [f"broke down: {error}"]} for name in names}


def study(regime: str, seeds: Sequence[int], names: Sequence[str] = (*FILTERS, "batch"), **options) -> dict:
    """A regime over many seeds, in parallel where `joblib.parallel_config` says so.

    Returns {"seeds": how many, "filters": name: figures}: nees_pose (6 is right), rmse_m (of the position as seen from
    frame 0), rejected_share (by the gate; 0 for the batch, which has none), each the mean over the drives whose filter
    did not break down, the RMSE a root of the mean square; warned, the share of the drives with a warning;
    warned_without_truth, the share with one that needs no ground truth; and warnings, those of the first warned drive.
    """
    jobs = (joblib.delayed(_attempt)(regime, seed, names, options) for seed in seeds)
    runs = list(tqdm(joblib.Parallel(return_as="generator")(jobs), total=len(seeds), desc=regime, unit="drive"))
    return {"seeds": len(seeds), "filters": {name: _over_seeds([run[name] for run in runs]) for name in names}}


def _over_seeds(runs) -> dict:
    nees, rmse, rejected = (np.array([run[key] for run in runs if key in run])
                            for key in ("nees_pose", "rmse_m", "rejected_share"))
    warned = [run["warnings"] for run in runs if run["warnings"]]
    means = {"nees_pose": nees.mean(), "rmse_m": np.sqrt(np.mean(rmse**2)), "rejected_share": rejected.mean()
             } if nees.size else dict.fromkeys(("nees_pose", "rmse_m", "rejected_share"), np.nan)
    return {key: float(value) if np.isfinite(value) else None for key, value in means.items()} | {
        "warned": len(warned) / len(runs),
        "warned_without_truth": sum(any(map(run_warnings.needs_no_truth, found)) for found in warned) / len(runs),
        "warnings": warned[0] if warned else []}


def format_study(regime: str, figures: dict) -> str:
    """The figures of a regime as text, a line for each filter."""
    return "\n".join(f"{regime:15}{name:15}" + "".join(
        f"{label} {'none' if one[key] is None else format(one[key], '.3g'):9}"
        for key, label in (("nees_pose", "NEES"), ("rmse_m", "RMSE m"), ("rejected_share", "rejected"),
                           ("warned", "warned"), ("warned_without_truth", "without truth"))).rstrip()
        for name, one in figures["filters"].items())
