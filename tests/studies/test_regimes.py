"""Regimes: where the filter is honest, where it is not, and that each regime is what its name says."""

import json

import numpy as np
import pytest

from vislam_edu import InverseDepth, metrics, window_slam
from vislam_edu.cli import main
from vislam_edu.studies import regimes

SEEDS = range(6)
FRAMES = 60
LOW, HIGH = metrics.chi2_band(6, len(SEEDS), probability=0.9999)  # 2.0 to 13.1


@pytest.mark.parametrize("regime", ["street", "few", "noisy", "jitter", "gaps", "slow", "short_baseline"])
def test_inverse_depth_is_honest_in_seven_regimes(regime):
    figures = regimes.study(regime, SEEDS, ["inverse_depth"], frames=FRAMES)["filters"]["inverse_depth"]
    assert LOW < figures["nees_pose"] < HIGH
    assert figures["rejected_share"] < 0.03


def test_a_car_that_stands_does_not_drift(monkeypatch):
    """Linearised once, it drifts forward by 11 cm in 300 frames, and by 2 cm in 60."""
    def forward():
        drive, noise = regimes.on_the_spot(0, frames=FRAMES)
        *_, last = window_slam.run(drive, noise, InverseDepth())
        return last.posterior.world_T_imu[0, 3]

    assert abs(forward()) < 0.01
    monkeypatch.setattr(InverseDepth, "iterated", False)
    assert forward() > 0.015


def test_a_baseline_of_5_cm_is_too_short_for_cartesian_landmarks():
    figures = regimes.study("short_baseline", SEEDS, ["cartesian"], frames=FRAMES)["filters"]["cartesian"]
    assert figures["nees_pose"] > HIGH


@pytest.mark.parametrize("regime", regimes.REGIMES)
def test_a_regime_has_the_noise_that_it_names(regime):
    """Pixels of the drive against those of its truth: their scatter, and how often there are any."""
    drive, noise = regimes.REGIMES[regime](3, frames=40)
    exact, in_front = drive.camera.observe(drive.true_world_T_imu[drive.frame], drive.true_landmarks[drive.landmark])
    assert in_front.all()
    assert np.std(drive.pixels - exact) == pytest.approx(noise.sigma_px, rel=6 / np.sqrt(2 * exact.size))
    if regime == "gaps":
        assert not drive.visible[:4].any()
        assert not drive.visible[16:20].any()


def test_the_command_writes_every_filter_and_the_batch(tmp_path, capsys):
    assert main(["consistency", "--regime", "standing", "--seeds", "1", "--frames", "20", "--out", str(tmp_path)]) == 0
    filters = json.loads((tmp_path / "summary.json").read_text())["regimes"]["standing"]["filters"]
    assert list(filters) == [*regimes.FILTERS, "batch"]
    for figures in filters.values():
        assert {"nees_pose", "rmse_m", "rejected_share", "warned"} <= figures.keys()
    assert "standing" in capsys.readouterr().out


def test_an_unknown_regime_ends_in_one_line(tmp_path, capsys):
    assert main(["consistency", "--regime", "moon", "--out", str(tmp_path)]) == 2
    assert "'moon' is not one of all, street, far" in capsys.readouterr().err
