"""Files that are there whole or not at all, and folders that can be written to."""

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
