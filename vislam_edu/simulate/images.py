"""Rendered images: a textured street around a block, seen by a stereo camera whose every pose and depth is exact.

`street_images` drives the road of `streets` between two rows of facades. Each pixel's ray is cut with ground and walls
in closed form; grey values are a fixed random function of the place on the surface, blurred to what a pixel covers
there, so that all images show one world. The sensors of the drive are those of `drives.perfect_street_loop`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from .. import se3, stereo
from ..drive import Drive
from ..lens import Lens, Rig
from ..stereo import StereoCamera
from . import drives, streets

SIZE = (400, 160)  # px, width and height
_GROUND = -1.35  # m, of the IMU's height: the camera is 0.3 m above the IMU and 1.65 m above the road
_WIDTH, _INNER_HEIGHT, _OUTER_HEIGHT = 9.0, 7.0, 10.0  # m, from the middle of the road to the walls, and their tops
_TEXTURE, _NOISE = 20, 21  # streams of a seed
_SIGMA_GREY = 2.0  # grey values, noise of every pixel
_SPEED = 7.0  # m/s, on average


def small_camera() -> StereoCamera:
    """KITTI's camera with a third of its pixels."""
    K = np.array([[240.0, 0.0, 199.5], [0.0, 240.0, 65.0], [0.0, 0.0, 1.0]])
    return StereoCamera(K, 0.54, drives.kitti_camera().cam_T_imu)


@dataclass(frozen=True, eq=False)
class StreetImages:
    """Pairs of images along a drive; a sequence, each pair rendered when it is asked for.

    drive : exact poses and IMU, no tracks. seed : of texture and noise.
    low, high : (2,) m, corners of the road's rectangle; the block is inside, the outer walls around it.
    """

    drive: Drive
    seed: int
    low: np.ndarray
    high: np.ndarray

    def __len__(self) -> int:
        return self.drive.n_frames

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        return (self[k] for k in range(len(self)))

    @property
    def rig(self) -> Rig:
        """Lenses without distortion, for `tracking.track`."""
        lens = Lens(self.drive.camera.K)
        return Rig(lens, lens, self.drive.camera)

    def __getitem__(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Left and right image of frame k, uint8 (height, width)."""
        if not 0 <= k < len(self):
            raise IndexError(f"frame {k} of {len(self)}")
        rng = np.random.default_rng((self.seed, _NOISE, k))
        images = []
        for side in (0.0, self.drive.camera.baseline):
            grey = self.render(k, side)[0]
            grey = grey + _SIGMA_GREY * rng.standard_normal(grey.shape, np.float32)
            images.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
        return images[0], images[1]

    def render(self, k: int, side: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Grey values without noise and depths, m: (height, width), of a camera `side` m to the right."""
        width, height = SIZE
        v, u = np.mgrid[:height, :width].astype(float)
        return self.look(k, np.stack([u, v], axis=-1), side)

    def look(self, k: int, pixels: np.ndarray, side: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Grey values (...) and depths (...), m, inf in the sky, at pixels (..., 2) of frame k."""
        assert self.drive.truth_world_T_cam is not None
        K, world_T_cam = self.drive.camera.K, self.drive.truth_world_T_cam[k]
        origin = se3.transform(world_T_cam, np.array([side, 0.0, 0.0]))
        ray = stereo.bearing(K, pixels) @ world_T_cam[:3, :3].T
        depth, axis = self._first_surface(origin, ray)
        hit = np.isfinite(depth)
        point = origin + np.where(hit, depth, 0.0)[..., None] * ray
        across = np.abs(np.take_along_axis(ray, axis[..., None], axis=-1)[..., 0]) / np.linalg.norm(ray, axis=-1)
        covers = np.where(hit, depth, 1.0) / K[0, 0] / np.maximum(across, 0.05)  # m, a pixel's longer side
        where = np.stack([np.where(axis == 0, point[..., 1], point[..., 0]),
                          np.where(axis == 2, point[..., 1], point[..., 2]) + 37.0 * axis], axis=-1)
        return np.where(hit, 115 + 45 * self._texture(where, covers), 215.0), depth

    def _first_surface(self, origin: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depths (...) along rays (..., 3) to ground, block or outer walls, inf where none, and the axis each faces."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ground = np.where(ray[..., 2] < 0, (_GROUND - origin[2]) / ray[..., 2], np.inf)
            (low, high), (outer_low, outer_high) = (
                ((self.low + width - origin[:2]) / ray[..., :2], (self.high - width - origin[:2]) / ray[..., :2])
                for width in (_WIDTH, -_WIDTH))
        into, out_of, outer = np.minimum(low, high), np.maximum(low, high), np.maximum(outer_low, outer_high)
        enter, leave = np.maximum(into[..., 0], into[..., 1]), np.minimum(out_of[..., 0], out_of[..., 1])
        walls = np.minimum(outer[..., 0], outer[..., 1])
        block = np.where((enter < leave) & (enter > 0), enter, np.inf)
        candidates = [ground]
        for depth, top in ((block, _INNER_HEIGHT), (walls, _OUTER_HEIGHT)):
            up = origin[2] + np.where(np.isfinite(depth), depth, 0.0) * ray[..., 2]
            candidates.append(np.where(up < top, depth, np.inf))
        depth = np.minimum.reduce(candidates)
        across = np.where(depth == candidates[1], into[..., 1] == enter, outer[..., 1] == walls)  # 1 where y is faced
        axis = np.where(depth == ground, 2, across)
        return depth, axis

    @cached_property
    def _octaves(self) -> np.ndarray:
        """(256, 256) of smooth periodic noise, unit variance, one wave about 8 cells long."""
        noise = np.random.default_rng((self.seed, _TEXTURE)).standard_normal((256, 256))
        smooth = ndimage.gaussian_filter(noise, 2.0, mode="wrap")
        return (smooth / smooth.std()).astype(np.float32)

    def _texture(self, where: np.ndarray, covers: np.ndarray) -> np.ndarray:
        """Sum of six scales of the same noise, each faded out where a pixel covers more than half its wave."""
        total = np.zeros(covers.shape)
        for octave in range(6):
            wave = 4.0 / 2**octave  # m
            weight = np.clip(wave / covers - 2.0, 0.0, 1.0)
            seen = weight > 0
            cells = (where[seen] * (8 / wave) + 91.7 * octave).T
            total[seen] += weight[seen] * ndimage.map_coordinates(self._octaves, cells, order=1, mode="grid-wrap")
        return total / 2.0


def street_images(seed: int = 0, *, frames: int = 100) -> StreetImages:
    """Images along `frames` frames (10 Hz) of a flat street loop of 400 m; the same seed gives the same ones."""
    loop_length = max(drives.SHORTEST_LOOP, _SPEED * 0.1 * frames)
    drive = drives.perfect_street_loop(seed, frames=frames, speed=_SPEED, hills=0.0, camera=small_camera(),
                                       loop_length=loop_length, image_size=SIZE, name="street images")
    drive = drive.keep_landmarks(np.zeros(drive.n_landmarks, bool)).replace(truth_landmarks=None)
    lap = np.array(streets.centre_line(loop_length)[3:])
    return StreetImages(drive, seed, lap.min(axis=1), lap.max(axis=1))


def with_true_landmarks(images: StreetImages, drive: Drive) -> Drive:
    """The drive, tracked in these images, with the truth: each landmark is the place that its first look shows."""
    landmarks, poses = np.full((drive.n_landmarks, 3), np.nan), images.drive.truth_world_T_cam
    assert poses is not None
    for k in range(drive.n_frames):
        ids, pixels = drive.observed(k)
        new = drive.first_seen[ids] == k
        depth = images.look(k, pixels[new, :2])[1]
        K = images.drive.camera.K
        rays = stereo.bearing(K, pixels[new, :2])
        landmarks[ids[new]] = se3.transform(poses[k], np.where(np.isfinite(depth), depth, np.nan)[:, None] * rays)
    return drive.replace(truth_world_T_cam=poses, truth_landmarks=landmarks)
