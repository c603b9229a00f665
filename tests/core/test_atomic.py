"""Files that are there whole or not at all, and folders that can be written to."""

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from navgym.core.atomic import replacing, writable_folder


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "a.txt"
    with replacing(path, text=True) as file:
        file.write("β\n")
        file.flush()
        assert not path.exists()
    assert path.read_bytes() == "β\n".encode()
    assert list(tmp_path.iterdir()) == [path]


def test_what_fails_on_the_way_leaves_the_old_file_alone(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def fail():
        with replacing(path) as file:
            file.write(b"new")
            raise RuntimeError("half way")

    with pytest.raises(RuntimeError, match="half way"):
        fail()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_that_fills_up_leaves_the_old_file_alone_and_is_named(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    code = (
        "import sys; from pathlib import Path; from navgym.core.atomic import replacing\n"
        "try:\n"
        "    with replacing(Path(sys.argv[1])) as file:\n"
        "        file.write(bytes(10**6))\n"
        "except OSError as error:\n"
        "    print(error)"
    )

    def full():  # from 1000 bytes on
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    words = [sys.executable, "-c", code, path]
    said = subprocess.run(words, preexec_fn=full, capture_output=True, text=True, check=True).stdout
    assert said.startswith(f"{path} cannot be written (File too large): make room.")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["/dev/null", "/dev/full", "."])
def test_a_device_or_a_folder_is_never_replaced(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = Path(name).stat().st_mode
    refused = pytest.raises(OSError, match=r"is no ordinary file, and cannot be replaced")
    with refused, replacing(Path(name)):
        pytest.fail("it was opened")
    assert Path(name).stat().st_mode == before
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_replaced_and_what_it_points_to_stays(tmp_path):
    theirs, link = tmp_path / "theirs", tmp_path / "link"
    theirs.write_text("theirs")
    link.symlink_to(theirs)
    with replacing(link, text=True) as file:
        file.write("ours")
    assert (theirs.read_text(), link.read_text()) == ("theirs", "ours")
    assert not link.is_symlink()


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_file_has_the_mode_that_the_umask_asks_for(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        with replacing(tmp_path / "a"):
            pass
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == mode


def test_ctrl_c_on_the_way_leaves_nothing_behind(tmp_path):
    def stopped():
        with replacing(tmp_path / "a"):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_made_with_its_parents_and_left_empty(tmp_path):
    folder = tmp_path / "runs" / "one"
    assert writable_folder("out", folder) == folder
    assert writable_folder("out", folder) == folder  # it may be there already
    assert list(folder.iterdir()) == []


def test_a_file_is_no_folder(tmp_path):
    path = tmp_path / "a.txt"
    path.touch()
    for taken in (path, path / "below"):
        with pytest.raises(ValueError, match="out must be a folder that can be written to"):
            writable_folder("out", taken)
