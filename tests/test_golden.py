"""No change of the code has changed a result that was not meant to change; see docs/design.md."""

import dataclasses

import numpy as np
import pytest

import navgym

pytest.importorskip("stable_baselines3")
pytest.importorskip("optuna")
pytest.importorskip("mealpy")

from tests.golden import book, rooms

FILTERS = book.read("filter")[1]


@pytest.mark.parametrize("room", rooms.ROOMS)
def test_every_result_is_what_it_was(room):
    platform, old = book.read(room)
    new = book.lines_of(rooms.entries(room))
    found = book.changes(old, new, platform == book.here())
    assert not found, "\n" + "\n".join(book.shown(key, *pair) for key, pair in found.items())


# ---- nothing is left out


@pytest.mark.filterwarnings("ignore:.*has identified nothing")
@pytest.mark.parametrize("scenario", rooms.scenario_names())
def test_every_scenario_is_filtered_by_every_filter_that_is_made_for_it(scenario):
    kept = {key.split("/")[3] for key in FILTERS if key.startswith(f"filter/{scenario}/")}
    for name in navgym.filters():
        try:
            navgym.estimate(name, rooms.recording_of(scenario))
        except ValueError:
            assert name not in kept
        else:
            assert name in kept


def test_every_environment_is_rolled_out():
    kept = {"/".join(key.split("/")[1:3]) for key in book.read("environment")[1]}
    assert kept == set(rooms.environment_ids())
    assert kept >= set(rooms.SINGLE)


# ---- it can fail


X = np.random.default_rng(0).normal(0.0, [1.0, 1e-4], (50, 2))
X[7, 0] = np.nan


def changed(array, same_platform=False, key="k"):
    return bool(
        book.changes(
            {key: book.Line.of(X)}, {key: book.Line.of(array)}, same_platform=same_platform
        )
    )


def test_the_last_bit_counts_where_the_platform_is_the_same_and_only_there():
    other = X.copy()
    other[3, 1] = np.nextafter(other[3, 1], 1.0)
    assert changed(other, same_platform=True)
    assert not changed(other)
    assert not changed(X, same_platform=True)


@pytest.mark.parametrize("place", [(0, 0), (49, 0), (0, 1), (30, 1)])
def test_elsewhere_a_millionth_of_any_number_counts_small_columns_included(place):
    other = X.copy()
    other[place] *= 1.0 + 1e-6
    assert changed(other)


def test_what_is_missing_counts_and_where():
    elsewhere = X.copy()
    elsewhere[7, 0], elsewhere[8, 0] = X[8, 0], np.nan
    assert changed(elsewhere)
    assert changed(np.nan_to_num(X))


def test_kinds_and_shapes_count():
    assert changed(X.astype(np.float32))
    assert changed(X.reshape(2, 50))


def test_a_key_that_is_new_or_gone_counts():
    line = {"k": book.Line.of(X)}
    assert list(book.changes({}, line, True)) == ["k"] == list(book.changes(line, {}, True))
    assert "missing" in book.shown("k", line["k"], None)
    with pytest.raises(ValueError, match="used twice"):
        book.lines_of([("k", X), ("k", X)])


def test_a_file_gives_back_what_was_written(tmp_path, monkeypatch):
    monkeypatch.setattr(book, "FOLDER", tmp_path)
    lines = {"b": book.Line.of(X), "a": book.Line.of([True, False])}
    book.write("room", lines)
    platform, back = book.read("room")
    assert platform == book.here()
    assert list(back) == ["a", "b"]
    assert not book.changes(lines, back, True)
    assert book.changes(lines, {**back, "a": dataclasses.replace(back["a"], missing=1)}, False)
