"""How cost grows: what a point measures, what is done about points that fail, and the page."""

import re
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

pytest.importorskip("tyro")
pytest.importorskip("matplotlib")

from navgym.command import main
from navgym.tuning.benchmarks import growth_page, scaling
from navgym.tuning.benchmarks.scaling import Growth, Point, Series, Work

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux tells of memory")
LINE = Series("kf", lambda size: None, (1, 10, 100))
GROWTH = Growth("rows", "Rows", "rows", "row", ("µs", 1e6), (LINE,), "Copies are made.")


def test_quick_measures_one_of_each_kind_and_writes_page_and_pictures(tmp_path, capsys):
    path = tmp_path / "growth.md"
    words = ["benchmark", "scaling", "--quick", "--rounds", "1", "--write", str(path)]
    assert main(words) == 0
    text = path.read_text("utf-8")
    assert text in capsys.readouterr().out
    for growth in scaling.growths(quick=True):
        assert re.search(rf"## {growth.title}\n", text)
        picture = tmp_path / "images" / f"scaling-{growth.name}.svg"
        assert f"(images/{picture.name})" in text
        assert ET.parse(picture).getroot().tag.endswith("svg")
    rows = re.findall(r"^\| [\d,]+ \| .* \| [\d.]+ [mµ]?s \| [\d.]+ [mµ]s \| .* MB \|", text, re.M)
    assert len(rows) == 4


def test_quick_is_refused_where_it_means_nothing(capsys):
    assert main(["benchmark", "auv", "--quick"]) == 2
    assert "--quick is of scaling only" in capsys.readouterr().err


# ---- a point


@LINUX
def test_memory_is_the_peak_of_the_turns_and_not_what_stays():
    before = scaling.measured_here(Work(lambda: None, 1, scaling.peak), 1)["memory"]
    work = Work(lambda: np.ones(10_000_000), 1, scaling.peak)
    grown = scaling.measured_here(work, 2)["memory"] - before
    assert 70e6 < grown < 120e6  # 80 MB of numbers, once


@LINUX
def test_memory_that_is_not_free_is_an_error_and_not_asked_for():
    code = (
        "import numpy as np\n"
        "from pathlib import Path\n"
        "from navgym.tuning.benchmarks import scaling\n"
        "free = int(scaling._told(Path('/proc/meminfo'), 'MemAvailable'))\n"
        "np.empty(free // 8)\n"  # it is promised while nobody writes to it
        "scaling._hold_to_free_memory()\n"
        "try: np.empty(free // 8)\n"
        "except MemoryError: print('refused')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "refused"


def test_a_point_that_takes_too_long_says_so_and_larger_ones_are_left_out(monkeypatch):
    monkeypatch.setattr(scaling, "BOUND", 0.05)
    growth = scaling.growths()[0]
    first, *rest = scaling._points(growth, growth.series[0], 1, False)
    assert first.trouble == "not within 0 s"
    assert [p.trouble for p in rest] == ["left out after the size before"] * 4


def test_a_point_that_fails_says_what_its_process_said():
    growth = scaling.growths()[1]
    series = replace(growth.series[0], label="no such filter")
    assert scaling.point(growth, series, 1, 1, False).trouble.endswith("StopIteration")


# ---- the page


def points(*seconds):
    return [Point(10**k, s, 10**k, 2e8 + 1e8 * k) for k, s in enumerate(seconds)]


def test_the_page_says_where_time_grew_most():
    text = growth_page.page(
        [(GROWTH, [(LINE, points(1.0, 5.0, 60.0))])], "it", "here", 0.1, "images"
    )
    assert "kf: 10 times the rows took at most 12.0 times as long (from 10 to 100)." in text
    assert "| 100 | kf | 60 s | 600 ms | 1.7 | 400 MB | 1.11 MB |" in text


def test_a_size_without_figures_is_a_row_with_its_reason():
    found = [*points(1.0, 5.0), Point(100, trouble="does not fit")]
    text = growth_page.page([(GROWTH, [(LINE, found)])], "it", "here", 0.1, "images")
    assert "| 100 | kf | does not fit |" in text
    assert "took at most 5.0 times as long" in text
    assert "svg" in growth_page.picture(GROWTH, [(LINE, found)])


@pytest.mark.parametrize("load", [0.1, 1.7])
def test_the_page_says_whether_others_were_at_work(load):
    text = growth_page.page([(GROWTH, [(LINE, points(1.0))])], "it", "here", load, "images")
    assert ("Something else had been at work" in text) == (load > 0.5)


@pytest.mark.parametrize(
    ("seconds", "wanted"),
    [(2.5e-6, "2.5 µs"), (0.0123, "12.3 ms"), (4.0, "4 s"), (123.4, "123 s"), (1234.0, "1,234 s")],
)
def test_times_are_told_in_the_unit_that_fits(seconds, wanted):
    assert growth_page.in_words(seconds) == wanted
