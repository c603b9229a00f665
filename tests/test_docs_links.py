"""Links, anchors and tests that README and docs name exist; so do the headings that code cites."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
MADE = ("build", "dist", "runs")  # folders that commands write
WRITTEN = {".md", ".py", ".toml", ".cff", ".txt"}
LINK = re.compile(r"\]\((?![a-z]+:)([^)\s]+)\)")
PATH = re.compile(r"(?<![\w./-])((?:agents|docs|navgym|scripts|tests|tuning)/[\w./-]*\w)")
OTHER = re.compile(r"\b[A-Z]{4,}\b|-v\d+$")  # navgym/NAME, and ids of environments
CITATION = re.compile(r"docs/[a-z0-9/-]+\.md(?:#[\w-]+)?")


def project_files():
    """Everything that people write here, and nothing that they install or run."""
    folders = [p for p in ROOT.iterdir() if p.is_dir() and re.fullmatch(r"\w+", p.name)]
    inside = [p for folder in folders if folder.name not in MADE for p in folder.rglob("*")]
    files = [p for p in [*ROOT.iterdir(), *inside] if p.is_file()]
    return [p for p in files if p.suffix in WRITTEN or p.name == "Makefile"]


def prose(page):
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)


def github_slug(heading):
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def anchors(page):
    """Anchors that the forge and the site agree on: of headings that a page has once."""
    found = [github_slug(h) for h in re.findall(r"^#{1,3} +(.+?) *#*$", prose(page), re.MULTILINE)]
    return {a for a in found if found.count(a) == 1}


def fault(target, base):
    """What is wrong with a link, or nothing."""
    path, _, anchor = target.partition("#")
    page = base / path if path else base
    if not page.exists():
        return f"{target}: no such file"
    if anchor and anchor not in anchors(page):
        return f"{target}: no such heading; there are {sorted(anchors(page))}"
    return ""


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_link_of_a_page_leads_somewhere(page):
    links = LINK.findall(prose(page))
    faults = [fault(t, page if t.startswith("#") else page.parent) for t in links]
    assert not list(filter(None, faults))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_file_that_a_page_names_exists(page):
    """In text and in commands; a policy is named without its ending."""
    named = set(PATH.findall(page.read_text("utf-8")))
    places = (ROOT, page.parent)  # a link of the page is relative to it
    assert not sorted(
        name
        for name in named
        if not OTHER.search(name)
        and not any((base / f"{name}{end}").exists() for base in places for end in ("", ".npz"))
    )


def test_every_heading_that_code_cites_exists():
    cited = {
        (p.relative_to(ROOT), target)
        for p in project_files()
        if p.suffix == ".py" and p != Path(__file__)
        for target in CITATION.findall(p.read_text("utf-8"))
    }
    faults = [f"{p} cites {wrong}" for p, target in sorted(cited) if (wrong := fault(target, ROOT))]
    assert not faults


def test_every_test_that_the_science_pages_name_exists():
    written = {
        name
        for p in (ROOT / "tests").rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)", p.read_text("utf-8"), re.MULTILINE)
    }
    named = {
        (p.name, name)
        for p in (ROOT / "docs" / "science").glob("*.md")
        for name in re.findall(r"`(test_\w+)`", p.read_text("utf-8"))
    }
    assert named
    assert not sorted((page, name) for page, name in named if name not in written)
