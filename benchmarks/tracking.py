"""The package's Lucas-Kanade beside OpenCV's, on a real sequence with known poses:

    python -m pip install opencv-python-headless && python benchmarks/tracking.py FOLDER

FOLDER holds images 000000.png ..., calib.txt (P0 row by row) and poses.txt (world_T_cam, 3 x 4 a row), as KITTI has
them. Prints the distance to the epipolar line (median, 90 %), the same after each true motion was turned to fit the
tracks (poses that are off by 0.03 degrees move a line by 0.3 px), the share of corners found, and CPU time beside
OpenCV's, which may use one thread here.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from scipy.optimize import least_squares

from vislam_edu import se3, tracking
from vislam_edu.cli.track import opencv_flow


def epipolar(K, one_T_other, points, found):
    """Distances (px) of points in the other image to the epipolar lines of those in the first: as given, turned."""
    T = se3.inverse(one_T_other)

    def distances(phi):
        F = np.linalg.inv(K).T @ se3.so3_hat(T[:3, 3]) @ se3.so3_exp(phi) @ T[:3, :3] @ np.linalg.inv(K)
        lines = np.column_stack([points, np.ones(len(points))]) @ F.T
        return (np.sum(lines[:, :2] * found, axis=1) + lines[:, 2]) / np.hypot(lines[:, 0], lines[:, 1])

    turned = least_squares(distances, np.zeros(3), loss="soft_l1", f_scale=0.1).x
    return np.abs([distances(np.zeros(3)), distances(turned)])


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
        (median, turned_median), (most, turned_most) = np.quantile(np.concatenate(errors, axis=1), [0.5, 0.9], axis=1)
        print(f"{name:12} {median:.2f} px (median), {most:.2f} px (90 %); turned {turned_median:.3f}, {turned_most:.2f}"
              f"; found {100 * np.mean(found_share):.0f} %  CPU {seconds[name] / seconds['OpenCV']:.1f} times OpenCV's")


if __name__ == "__main__":
    main()
