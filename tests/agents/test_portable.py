"""A pair of files that any Python reads: NAME.npz and NAME.json."""

import json
import shutil

import numpy as np
import pytest

from navgym.agents.combiner.combiner import Combiner
from navgym.agents.policies import portable
from navgym.agents.policies.policy import PRETRAINED, Policy

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


def test_names_that_nobody_asks_for_may_be_absent(tmp_path):
    written = portable.write(tmp_path / "thing", KIND, ARRAYS, {"size": 3})
    assert portable.read(written, KIND, ("size",))[0]["size"] == 3


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_each_of_both_files_is_needed(written, suffix):
    written.with_suffix(suffix).unlink()
    with pytest.raises(FileNotFoundError):
        portable.read(written, KIND)


def leaves(value, way=()):
    """Where each number, text, flag or nothing of plain data lies."""
    if isinstance(value, dict):
        return [found for k, v in value.items() for found in leaves(v, (*way, k))]
    if isinstance(value, list):
        return [found for i, v in enumerate(value) for found in leaves(v, (*way, i))]
    return [way]


def changed(value, way, to):
    """Plain data with another leaf."""
    if not way:
        return to
    copy = value.copy()
    copy[way[0]] = changed(value[way[0]], way[1:], to)
    return copy


@pytest.mark.parametrize("kind", ["auv", "deck", "combiner"])
def test_an_edit_of_any_word_or_number_of_what_is_shipped_is_noticed(kind, tmp_path):
    path, load = tmp_path / "copy.npz", (Combiner if kind == "combiner" else Policy).load
    for suffix in (".npz", ".json"):
        shutil.copy((PRETRAINED / kind).with_suffix(suffix), path.with_suffix(suffix))
    beside = path.with_suffix(".json")
    facts = json.loads(beside.read_text(encoding="utf-8"))
    load(path)
    found = leaves({k: v for k, v in facts.items() if k not in ("kind", "format")})
    assert len(found) > 50
    for way in found:
        beside.write_text(json.dumps(changed(facts, way, "another")))
        with pytest.raises(ValueError, match=r"does not belong to .*, or one of them was edited"):
            portable.read(path, facts["kind"])


def test_how_the_json_is_laid_out_does_not_matter(written):
    beside = written.with_suffix(".json")
    facts = json.loads(beside.read_text(encoding="utf-8"))
    beside.write_text(json.dumps(dict(reversed(facts.items())), indent=7))
    assert portable.read(written, KIND)[0] == facts


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nests too deep"),
        ('{"a":' * 100_000, "nests too deep"),
        ('"' + "x" * 2**24, "has more than 17 MB"),
        ("7", "does not describe"),
        (b"\xff\xfe", "no text in UTF-8"),
        ('{"n": ' + "9" * 5000 + "}", "does not describe"),
    ],
)
def test_json_that_was_made_to_harm_is_refused(written, text, message):
    content = text if isinstance(text, bytes) else text.encode()
    written.with_suffix(".json").write_bytes(content)
    with pytest.raises(ValueError, match=message):
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
