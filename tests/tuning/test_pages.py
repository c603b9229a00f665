"""Pages fit in a browser, on a desk and on a telephone; no label stands over another."""

import pytest

from navgym.inspection.inspect import inspect
from navgym.tuning.report import page as report
from navgym.tuning.report.inspection import write
from navgym.tuning.report.page import Page, Section, Table
from tests.browser import check, looked_at, needs_browser
from tests.inspection import logs

PAGES = (
    "velocities are in knots",
    "fixes are held between those of a slower receiver",
    "an_imu_is_mounted_the_other_way_up",
)


@needs_browser
@pytest.mark.parametrize("name", PAGES)
def test_the_page_of_an_inspection_fits(name, tmp_path):
    found = inspect(logs.DEFECTS[name][2](tmp_path))
    check(write(tmp_path / "page.html", found), tmp_path)


@needs_browser
def test_a_table_that_is_wider_than_a_telephone_scrolls_within_the_page(tmp_path):
    table = Table([f"column {k}" for k in range(12)], [["1234.5"] * 12])
    page = Page("wide", ["A wide table."], [Section("Table", items=[table])])
    check(report.write_page(tmp_path / "page.html", page), tmp_path)


@needs_browser
def test_what_is_too_wide_and_what_fails_is_seen(tmp_path):
    page = tmp_path / "page.html"
    page.write_text(
        "<html><head></head><body><div style='width:900px'>x</div><script>nothing()</script></body></html>"
    )
    found = looked_at(page, 420, tmp_path)
    assert found["wide"]
    assert "nothing is not defined" in found["wrong"][0]


def test_a_page_names_every_finding_and_the_next_command(tmp_path):
    found = inspect(logs.DEFECTS[PAGES[0]][2](tmp_path))
    text = write(tmp_path / "page.html", found).read_text("utf-8")
    assert all(f.kind in text and f.remedy[1:] in text for f in found.findings)
    assert "units.vx kn" in text
