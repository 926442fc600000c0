"""Settings shared by all tests."""

import pytest
from hypothesis import settings

# No deadline: the first call pays for imports, and a busy machine is not a defect of the code under test.
settings.register_profile("project", deadline=None)
settings.load_profile("project")

pytest.register_assert_rewrite("picture_checks")  # its failures show their values, as those of a test file do
