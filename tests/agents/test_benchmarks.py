"""The table of speeds can be made."""

import re

import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

from navgym.agents import benchmarks


@pytest.mark.slow
def test_every_row_says_what_was_found(monkeypatch):
    monkeypatch.setattr(benchmarks, "POOL", 4)
    monkeypatch.setattr(benchmarks, "CALLS", 20)
    rows = benchmarks.agents(1)
    assert len(rows) == 6
    told = r"\dx \([\d,.]+ against [\d,.]+ |\d µs more \([\d.]+ the bank\)"
    assert all(re.search(told, row.found) for row in rows)
