"""What several test files share."""

from pathlib import Path

import pytest
from hypothesis import settings

import tests.toy  # noqa: F401 - a third problem, which every test of all problems includes
from navgym.core.data import VARIABLE, data_folder

# the same examples on every run and machine; kernels compile inside the first one
settings.register_profile("repeatable", deadline=None, max_examples=25, derandomize=True)
settings.register_profile("thorough", deadline=None, max_examples=1000)  # --hypothesis-profile
settings.load_profile("repeatable")


def real_data(name: str) -> Path:
    """Folder of a public data set; skips the test where the user has named none."""
    folder = data_folder(name)
    if folder is None:
        pytest.skip(f"${VARIABLE} names no folder that holds the public data set {name!r}")
    return folder


@pytest.fixture(scope="session")
def akit() -> Path:
    """Folder with tracks 1-6 of A-KIT."""
    return real_data("akit")
