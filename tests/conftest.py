"""What several test files share."""

from pathlib import Path

import pytest
from hypothesis import settings

import tests.toy  # noqa: F401 - a third problem, which every test of all problems includes

# the same examples on every run and machine; kernels compile inside the first one
settings.register_profile("repeatable", deadline=None, max_examples=25, derandomize=True)
settings.register_profile("thorough", deadline=None, max_examples=1000)  # --hypothesis-profile
settings.load_profile("repeatable")

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def real_data(name: str) -> Path:
    """Folder of a public data set beside the repository; skips the test where it is absent."""
    folder = REAL_DATA / name
    if not folder.is_dir():
        pytest.skip(f"the public data set {name!r} is not beside the repository (shared/data)")
    return folder


@pytest.fixture(scope="session")
def akit() -> Path:
    """Folder with tracks 1-6 of A-KIT."""
    return real_data("akit")
