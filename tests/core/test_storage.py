"""Files that were made to harm, or harmed: each is refused by name, nothing is unpacked or unpickled."""

import io
import json
import pickle
import time
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.core import storage
from navgym.core.storage import parse_json, read_npz, read_toml, settings_text


def npy(array):
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def archive(path, members, how=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", how) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return path


def locked(path):
    """Mark every member as encrypted, as the format does: a bit in both of its headers."""
    content = bytearray(path.read_bytes())
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = content.find(mark)
        while at >= 0:
            content[at + offset] |= 1
            at = content.find(mark, at + 1)
    path.write_bytes(content)


def claims(shape):
    """An array of 80 bytes that says it is larger."""
    return npy(np.zeros(10)).replace(b"(10,), }" + b" " * 20, f"{shape!s}, }}".encode().ljust(28))


class Trap:
    def __reduce__(self):
        return pytest.fail, ("unpickled",)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy(np.zeros(3)), "not a zip file"),
        (pickle.dumps(Trap()), "not a zip file"),
        (b"", "not a zip file"),
        ({"a.npy": npy(np.array([Trap()], dtype=object))}, "Object arrays"),
        ({"a.npy": pickle.dumps(Trap())}, "a.npy is no array|a is no array"),
        ({"notes.txt": b"hello"}, "notes.txt is no array"),
        ({"a.npy": npy(np.zeros(1000))[:-9]}, "array data"),
        ({"a.npy": claims((10**15,))}, "."),
        ({"a.npy": claims((2**62, 2**62))}, "."),
    ],
)
def test_what_is_no_npz_of_numbers_is_refused_and_never_unpickled(tmp_path, content, message):
    path = tmp_path / "a.npz"
    if isinstance(content, dict):
        archive(path, content)
    else:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"a.npz is none \((?s:.)*{message}(?s:.)*\)\. Save it"):
        read_npz(path, "is none", "Save it again.")


def test_an_encrypted_archive_is_refused(tmp_path):
    path = archive(tmp_path / "a.npz", {"a.npy": npy(np.zeros(3))})
    locked(path)
    with pytest.raises(ValueError, match=r"a.npz is none \(it is encrypted\)"):
        read_npz(path, "is none", "")


def test_an_archive_that_unpacks_to_far_more_than_it_is_is_refused(tmp_path, monkeypatch):
    archive(tmp_path / "a.npz", {"time.npy": npy(np.zeros(10**7))})  # 80 MB in 80 kB
    assert len(read_npz(tmp_path / "a.npz", "", "")["time"]) == 10**7
    monkeypatch.setattr(storage, "ROOM", 2**20)
    with pytest.raises(ValueError, match=r"unpacks to 0.08 GB, far more than any such file"):
        navgym.Recording.load(tmp_path / "a.npz")


def test_nothing_is_written_over_the_bound_unnoticed(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "ROOM", 0)  # then a recording of its own bytes must still pass
    recording = navgym.simulate("auv/switch-D", seed=1, steps=500)
    recording.save(tmp_path / "a.npz")
    assert len(navgym.Recording.load(tmp_path / "a.npz")) == 500


@pytest.mark.parametrize(
    "header",
    [
        "[" * 10**5,
        "[]",
        "7",
        '{"navgym": 1}',
        '{"navgym": 1, "meta": 3}',
        '{"navgym": [1]}',
        "\x00",
    ],
)
def test_a_header_that_was_made_to_harm_is_refused_by_name(tmp_path, header):
    with (tmp_path / "a.npz").open("wb") as file:
        np.savez_compressed(file, header=np.array(header), time=np.arange(3.0))
    with pytest.raises(ValueError, match=r"a\.npz"):
        navgym.Recording.load(tmp_path / "a.npz")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "a.npz"
    navgym.simulate("auv/switch-D", seed=1, steps=30).save(path)
    return path.read_bytes()


@given(place=st.floats(0.0, 1.0), byte=st.integers(0, 255), cut=st.booleans())
def test_a_byte_that_changed_or_an_end_that_is_missing_raises_nothing_else(
    place, byte, cut, whole, tmp_path_factory
):
    path = tmp_path_factory.mktemp("damaged") / "a.npz"
    at = int(place * (len(whole) - 1))
    path.write_bytes(whole[:at] if cut else whole[:at] + bytes([byte]) + whole[at + 1 :])
    try:
        navgym.Recording.load(path)
    except ValueError as error:
        message = str(error)
        assert "a.npz" in message
    else:
        assert not cut


# ---- settings


@pytest.mark.parametrize("text", ["a = " + "[" * 50_000, "a = " + "{a = " * 50_000])
def test_tables_without_end_are_refused(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(
        ValueError, match=r"a\.toml is not TOML that can be read: it nests too deep"
    ):
        read_toml(tmp_path / "a.toml")


def test_a_file_without_end_is_refused_at_once(tmp_path):
    began = time.perf_counter()
    with pytest.raises(ValueError, match=r"/dev/zero has more than 17 MB"):
        read_toml("/dev/zero")
    with (tmp_path / "a.toml").open("wb") as file:
        file.truncate(300 * 10**6)
    with pytest.raises(ValueError, match=r"a.toml has more than 17 MB"):
        read_toml(tmp_path / "a.toml")
    assert time.perf_counter() - began < 1.0


def test_a_byte_order_mark_and_the_line_ends_of_windows_are_fine(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 'x'\r\n")
    assert read_toml(tmp_path / "a.toml") == {"a": 1, "b": "x"}


def test_what_is_no_text_is_refused(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"a = \xff")
    with pytest.raises(ValueError, match=r"a\.toml is no text in UTF-8"):
        settings_text(tmp_path / "a.toml")


@pytest.mark.parametrize("text", ["[" * 10**6, '{"a":' * 10**6])
def test_json_without_end_is_a_value_error(text):
    with pytest.raises(ValueError, match="nests too deep"):
        parse_json(text)
    assert parse_json(json.dumps({"a": [1]})) == {"a": [1]}
