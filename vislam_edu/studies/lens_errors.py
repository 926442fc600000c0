"""What a drive says of its own lenses: seven numbers of the calibration, estimated with the path and the map.

    found, _ = lens_errors.estimate(batch.Problem(drive, noise))
    print(found)
    better = found.corrected(drive)     # or another drive of the same cameras

An error of a lens is the same in every frame, so a batch estimate can find it: each number is one more unknown that
touches every pixel. Not all of them can be told from the world. Focal length and radial term change the picture as a
slightly different path through slightly different scenery would: left free they run away and take the path with them.
So their prior is tight. The disparity's terms are seen well and are off by pixels on real cameras: their prior is
loose.

Source: Triggs et al., Bundle adjustment: a modern synthesis, 2000 (self-calibration, priors on what is weakly seen).
"""

import json
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..drive import DriveError
from ..simulate import faults
from . import calibration, pipeline

PRIOR_PX = calibration.LENS_PX | {"focal_length": 0.2, "radial": 0.2}


@dataclass(frozen=True, eq=False)
class LensErrors:
    """What the lenses were found to be off by.

    px, sigma_px : of each of `PRIOR_PX`, its size as `faults.lens_error` plants it, px, and one standard deviation.
    focal_length_px, baseline_m : of the calibration that it corrects.
    """

    px: dict[str, float]
    sigma_px: dict[str, float]
    focal_length_px: float
    baseline_m: float

    def __str__(self) -> str:
        rows = (f"    {name.replace('_', ' '):22}{self.px[name]:+7.2f} px, sigma {self.sigma_px[name]:.2f}"
                for name in PRIOR_PX)
        return "\n".join(["lens, at one focal length from the centre of the image:", *rows])

    def corrected(self, drive):
        """The `Drive` with its pixels as these cameras would have measured them without the error.

        Raises DriveError where focal length or baseline are not, within 5 %, those it was learnt with.
        """
        K, b = drive.camera.K, drive.camera.baseline
        if not np.allclose([K[0, 0], b], [self.focal_length_px, self.baseline_m], rtol=0.05):
            raise DriveError(f"the lens was learnt with a focal length of {self.focal_length_px:.1f} px and a baseline "
                             f"of {self.baseline_m:.3f} m; the camera here has {K[0, 0]:.1f} px and {b:.3f} m")
        return drive.replace(pixels=drive.pixels - faults.lens_shift(drive, **self.px),
                             history=(*drive.history, calibration.LENS_CORRECTED))

    def save(self, path):
        """Write it to a JSON file. path : pathlib.Path."""
        path.write_text(json.dumps(asdict(self), indent=2) + "\n", encoding="utf-8")


def load(path) -> LensErrors:
    """The `LensErrors` that were saved. path : pathlib.Path. Raises DriveError when the file holds none."""
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        px, sigma_px = ({name: float(read[key][name]) for name in PRIOR_PX} for key in ("px", "sigma_px"))
        lens = LensErrors(px, sigma_px, float(read["focal_length_px"]), float(read["baseline_m"]))
    except (ValueError, TypeError, KeyError) as error:
        raise DriveError(f"{path}: not a lens as `run --lens` writes it ({type(error).__name__}: {error})") from None
    if not np.isfinite([*lens.px.values(), *lens.sigma_px.values()]).all():
        raise DriveError(f"{path}: a number of the lens is not finite")
    return lens


def with_lens(problem, estimate):
    """The `batch.Problem` with the numbers of `PRIOR_PX` as further unknowns. estimate : `batch.Estimate` without them.

    The shifts are taken where the landmarks should be seen, not where they were measured: shifts that follow the noise
    could make the residuals smaller by shrinking the image, and would.
    """
    drive = problem.drive
    predicted, in_front = drive.camera.observe(estimate.world_T_imu[drive.frame], estimate.landmarks[problem.landmark])
    at = drive.replace(pixels=np.where(in_front[:, None], predicted, drive.pixels))
    shifts = [faults.lens_shift(at, **{name: 1.0}) for name in PRIOR_PX]
    return replace(problem, lens=np.stack(shifts, axis=-1), lens_sigma=np.array(list(PRIOR_PX.values())))


def estimate(problem, world_T_imu=None) -> tuple[LensErrors, pipeline.Smoothed]:
    """The lens of a drive, and the batch estimate in which it was found.

    problem : `batch.Problem` without a lens. world_T_imu : (T, 4, 4) poses to begin with, by default dead reckoning.
    """
    first = pipeline.run_batch(problem, world_T_imu).solution.estimate
    smoothed = pipeline.run_batch(with_lens(problem, first), first.world_T_imu)
    solution, camera = smoothed.solution, problem.drive.camera
    sigma = np.sqrt(np.diagonal(solution.lens_covariance()))
    px, sigma_px = (dict(zip(PRIOR_PX, map(float, numbers))) for numbers in (solution.estimate.lens, sigma))
    return LensErrors(px, sigma_px, float(camera.K[0, 0]), float(camera.baseline)), smoothed
