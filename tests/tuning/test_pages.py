"""Pages fit in a browser, on a desk and on a telephone, by day and by night; no label stands over another."""

import pytest

from navgym.inspection.inspect import inspect
from navgym.tuning.report import page as report
from navgym.tuning.report.inspection import write
from navgym.tuning.report.page import Page, Section, Table
from tests.browser import check, looked_at, needs_browser
from tests.inspection import logs

KNOTS = "velocities are in knots"
OTHERS = {
    "held": "fixes are held between those of a slower receiver",
    "ins": "an_imu_is_mounted_the_other_way_up",
}


@pytest.fixture(scope="module")
def knots(tmp_path_factory):
    """The page of an inspection, and what was found."""
    return _inspected(KNOTS, tmp_path_factory.mktemp("pages") / "knots.html")


def _inspected(name, path):
    found = inspect(logs.DEFECTS[name][2](path.parent))
    return write(path, found), found


@needs_browser
def test_pages_fit(knots, tmp_path):
    table = Table([f"column {k}" for k in range(12)], [["1234.5"] * 12])
    page = Page("wide", ["A wide table."], [Section("Table", items=[table])])
    check([knots[0], report.write_page(tmp_path / "table.html", page)], tmp_path)


@needs_browser
@pytest.mark.slow
def test_pages_of_other_logs_fit(tmp_path):
    check([_inspected(n, tmp_path / f"{k}.html")[0] for k, n in OTHERS.items()], tmp_path)


@needs_browser
def test_what_is_wrong_with_a_page_is_seen(tmp_path):
    page = tmp_path / "page.html"
    page.write_text(
        "<html><head></head><body style='background:#fff;color:#fff'><div style='width:900px'>x</div>"
        "<script>nothing()</script></body></html>"
    )
    found = looked_at([page], tmp_path, [420], ["light"])["page 420 light"]
    assert found["wide"]
    assert found["pale"] == ["DIV  x"]
    assert "nothing is not defined" in found["wrong"][0]


def test_a_page_names_every_finding_and_the_next_command(knots):
    path, found = knots
    text = path.read_text("utf-8")
    assert all(f.kind in text and f.remedy[1:] in text for f in found.findings)
    assert "units.vx kn" in text
