"""The package's Lucas-Kanade beside OpenCV's, on a real sequence with known poses:

    python -m pip install opencv-python-headless && python benchmarks/tracking.py FOLDER

FOLDER holds images 000000.png ..., calib.txt (P0 row by row) and poses.txt (world_T_cam, 3 x 4 a row), as KITTI has
them. Prints the distance to the epipolar line (median, 90 %), the share of corners found, and CPU time beside
OpenCV's, which may use one thread here.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from vislam_edu import se3, tracking
from vislam_edu.cli.track import opencv_flow


def epipolar(K, one_T_other, points, found):
    """Distance (px) of points in the other image to the epipolar lines of those in the first."""
    T = se3.inverse(one_T_other)
    F = np.linalg.inv(K).T @ se3.so3_hat(T[:3, 3]) @ T[:3, :3] @ np.linalg.inv(K)
    lines = np.column_stack([points, np.ones(len(points))]) @ F.T
    return np.abs(np.sum(lines[:, :2] * found, axis=1) + lines[:, 2]) / np.hypot(lines[:, 0], lines[:, 1])


def main():
    """Tracks 200 corners from each image to the next with both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    cv2.setNumThreads(1)
    numbers = [word for word in (folder / "calib.txt").read_text().split() if not word.endswith(":")]
    K = np.array(numbers[:12], float).reshape(3, 4)[:, :3]
    poses = np.array([se3.pose(row[:, :3], row[:, 3]) for row in np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)])
    images = [tracking.pyramid(np.asarray(Image.open(path).convert("L"), float))
              for path in sorted(folder.glob("*.png"))]
    seconds = {}
    for name, flow in (("OpenCV", opencv_flow), ("vislam_edu", tracking.flow)):
        errors, found_share, begin = [], [], time.thread_time()
        for k in range(len(images) - 1):
            points = tracking.corners(images[k][0], 200)
            found, ok = flow(images[k], images[k + 1], points)
            errors.append(epipolar(K, se3.inverse(poses[k]) @ poses[k + 1], points[ok], found[ok]))
            found_share.append(ok.mean())
        seconds[name] = time.thread_time() - begin
        e = np.concatenate(errors)
        print(f"{name:12} {np.median(e):.2f} px (median)  {np.quantile(e, 0.9):.2f} px (90 %)  found "
              f"{100 * np.mean(found_share):.0f} %  CPU {seconds[name] / seconds['OpenCV']:.1f} times OpenCV's")


if __name__ == "__main__":
    main()
