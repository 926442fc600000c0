"""The report's figures 8 to 14 and 18 to 20, its longer recording: python benchmarks/second_recording.py

Drawn from `10.npz` where it lies in `data/`, with the noise of the simulator, else from a simulated drive of its size.
Half a minute. (`python -m vislam_edu run 10.npz --audit` measures the noise of a real recording and cures its faults.)
"""

import argparse
from pathlib import Path

from vislam_edu.course.ch09 import second_recording
from vislam_edu.error_state import RightInvariant
from vislam_edu.noise import Noise


def main():
    """Draw all ten."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/second_recording"), help="folder, made if missing")
    parser.add_argument("--frames", type=int, default=second_recording.FRAMES, help="only so many frames")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    drive = second_recording.load(arguments.frames)
    print(f"{drive.name}: {drive.n_frames} frames, {drive.n_landmarks} landmarks")
    for number, figure in second_recording.figures(drive, Noise(), RightInvariant()):
        figure.savefig(arguments.out / f"figure_{number:02d}.png", bbox_inches="tight")
        print(f"figure {number}: {figure.axes[0].get_title(loc='left')}".replace("\n", " "))


if __name__ == "__main__":
    main()
