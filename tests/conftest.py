"""Settings shared by all tests."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from vislam_edu import stereo
from vislam_edu.recordings import layouts

# No deadline: the first call pays for imports, and a busy machine is not a defect of the code under test.
settings.register_profile("project", deadline=None)
settings.load_profile("project")

pytest.register_assert_rewrite("picture_checks")  # its failures show their values, as those of a test file do


_FOLDERS, _SHARED = layouts.folders, Path(__file__).resolve().parents[2] / "shared" / "data"
layouts.folders = lambda: [*_FOLDERS(), _SHARED]  # tests also find the course's recordings in ../shared/data


@pytest.fixture
def first_order(monkeypatch):
    """Filters without the second-order mean: on a noise-free drive nothing then moves their estimate from the truth."""
    monkeypatch.setattr(stereo, "second_order", lambda predicted, explained: np.zeros_like(predicted))
