import shutil

import pytest

from tests.tuning.programs import making


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """A folder with the program in C, its contract and six logs."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("walk")
    making.compiled(folder)
    making.contract(folder)
    making.logs(folder, 6)
    return folder


@pytest.fixture
def script(tmp_path):
    """What makes a program of lines of sh that is called PARAMETERS LOG OUT."""

    def make(text):
        path = tmp_path / "program"
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
        return path

    return make
