"""Settings shared by all tests."""

from hypothesis import settings

# No deadline: the first call pays for imports, and a busy machine is not a defect of the code under test.
settings.register_profile("project", deadline=None)
settings.load_profile("project")
