"""A pair of files that any Python reads: NAME.npz and NAME.json."""

import json

import numpy as np
import pytest

from navgym.agents.policies import portable

KIND = "navgym thing"
ARRAYS = {"w": np.arange(6.0).reshape(2, 3), "b": np.array([1.5], dtype=np.float32)}


@pytest.fixture
def written(tmp_path):
    return portable.write(tmp_path / "thing", KIND, ARRAYS, {"note": "β", "size": 3})


@pytest.mark.parametrize("name", ["thing", "thing.npz", "thing.json"])
def test_what_was_written_is_read_by_any_of_its_names(written, name):
    header, arrays = portable.read(written.parent / name, KIND, ("note", "size"))
    assert (header["kind"], header["note"], header["size"]) == (KIND, "β", 3)
    assert set(arrays) == set(ARRAYS)
    for key, value in ARRAYS.items():
        assert arrays[key].dtype == value.dtype
        np.testing.assert_array_equal(arrays[key], value)
    assert sorted(p.name for p in written.parent.iterdir()) == ["thing.json", "thing.npz"]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_json_cannot_hold_is_refused_before_anything_is_written(tmp_path, value):
    with pytest.raises(ValueError, match="JSON"):
        portable.write(tmp_path / "thing", KIND, ARRAYS, {"score": float(value)})
    assert not list(tmp_path.iterdir())


def rewritten(path, **changes):
    """The header with some entries changed; None takes one out."""
    beside = path.with_suffix(".json")
    header = json.loads(beside.read_text(encoding="utf-8")) | changes
    beside.write_text(json.dumps({k: v for k, v in header.items() if v is not None}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "navgym other"}, "describes a navgym other, not a navgym thing"),
        ({"kind": None}, "does not describe a navgym thing"),
        ({"format": None}, "does not describe a navgym thing"),
        ({"format": portable.FORMAT + 1}, f"has format {portable.FORMAT + 1}"),
        ({"sha256": None}, "lacks 'sha256'"),
        ({"note": None}, "lacks 'note'"),
        ({"size": None}, "lacks 'size'"),
        ({"sha256": "0" * 64}, "belong"),
    ],
)
def test_a_header_that_was_changed_is_refused_by_what_is_wrong(written, changes, message):
    rewritten(written, **changes)
    with pytest.raises(ValueError, match=message):
        portable.read(written, KIND, ("note", "size"))


def test_names_that_nobody_asks_for_may_be_absent(written):
    rewritten(written, note=None)
    assert portable.read(written, KIND, ("size",))[0]["size"] == 3


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_each_of_both_files_is_needed(written, suffix):
    written.with_suffix(suffix).unlink()
    with pytest.raises(FileNotFoundError):
        portable.read(written, KIND)


def test_the_digest_is_of_names_shapes_types_and_values():
    same = portable.digest({k: v.copy() for k, v in ARRAYS.items()})
    assert portable.digest(ARRAYS) == same
    w = ARRAYS["w"]
    others = [
        {"v": w}, {"w": w.reshape(3, 2)}, {"w": w.astype(np.float32)}, {"w": w + 1e-12}, {},
    ]  # fmt: skip
    found = {portable.digest({"b": ARRAYS["b"]} | other) for other in others}
    assert len(found) == len(others)
    assert same not in found
