"""Reports: one self-contained page for people, one JSON file for programs, both written whole."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

import navgym
from navgym.core.atomic import replacing

LIBRARIES = ("numpy", "scipy", "numba", "optuna", "matplotlib")


@dataclass(frozen=True)
class Tile:
    """A number that the page shows large."""

    value: str
    what: str
    kind: str = ""


@dataclass(frozen=True)
class Table:
    """Cells as text.

    Args:
        head: column titles; the first column is text, the others are numbers.
        rows: cells.
        caption: what to see, one or two sentences.
        kinds: a kind per row: "bound", "diverged", "best", "own" or nothing.
        text_columns: further columns that hold text.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    kinds: Sequence[str] = ()
    text_columns: Sequence[int] = (0,)

    def kind(self, row: int) -> str:
        """Kind of row `row`."""
        return self.kinds[row] if row < len(self.kinds) else ""

    def as_text(self) -> str:
        """The table for a terminal, aligned."""
        lines = [[cell.replace("**", "") for cell in row] for row in (self.head, *self.rows)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.head))]
        text = [
            "  ".join(
                cell.ljust(w) if i in self.text_columns else cell.rjust(w)
                for i, (cell, w) in enumerate(zip(line, widths, strict=True))
            ).rstrip()
            for line in lines
        ]
        return "\n".join([text[0], "-" * max(map(len, text)), *text[1:]])


@dataclass(frozen=True)
class Figure:
    """An inline drawing (SVG source) with what to see in it.

    Args:
        svg: for screens that are wide.
        caption: what to see.
        narrow: the same with less width and letters of the same size, for a telephone.
    """

    svg: str
    caption: str
    narrow: str = ""


@dataclass(frozen=True)
class Section:
    """A part of the page: words, then figures and tables in their order."""

    title: str
    text: Sequence[str] = ()
    items: Sequence[Table | Figure] = ()
    folded: bool = False


@dataclass(frozen=True)
class Page:
    """A whole report.

    Args:
        title: of the page.
        lede: what came out, in sentences.
        sections: the parts.
        tiles: numbers that are shown large.
        provenance: what it rests on.
        banner: what the reader must know first, such as that a run was shortened; "" for nothing.
    """

    title: str
    lede: Sequence[str]
    sections: Sequence[Section]
    tiles: Sequence[Tile] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    banner: str = ""


def write_page(path: Path, page: Page) -> Path:
    """Write `page` as one HTML file that needs nothing else; returns the path."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("navgym.tuning.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"rich": _rich, "figure": _drawn}
    environment.tests["table"] = lambda item: isinstance(item, Table)
    html = environment.get_template("report.html").render(page=page)
    return write_text(path, html)


SHORTENED = (
    "Shortened with --quick: few recordings and trials, only to see it run. **Do not quote these "
    "numbers**; the same command without --quick makes those."
)


def write_json(path: Path, value: Any) -> Path:
    """Write `value` as JSON; ValueError for NaN or infinity, which JSON does not have."""
    return write_text(path, json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> Path:
    """Write a file whole or not at all: a reader never sees half of it; returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, text=True) as file:
        file.write(text)
    return path


def provenance(command: str, **settings: Any) -> dict[str, Any]:
    """What a result rests on: the command as it was given, versions, and `settings`."""
    return {
        "command": command,
        "versions": {"navgym": navgym.__version__, "python": platform.python_version()}
        | {name: metadata.version(name) for name in LIBRARIES},
        **settings,
    }


def _drawn(figure: Figure) -> Markup:
    if not figure.narrow:
        return Markup(figure.svg)  # noqa: S704 - ours
    wide, narrow = (f'<div class="{k}">{v}</div>' for k, v in (("wide", figure.svg), ("narrow", figure.narrow)))  # fmt: skip
    return Markup(wide + narrow)  # noqa: S704 - ours


def _rich(text: str) -> Markup:
    """Escaped text in which `code` and **strong** mean what they look like."""
    html = str(escape(text))
    html = re.sub(r"`([^`]+)`", lambda found: f"<code>{_unbroken(found[1])}</code>", html)
    return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", html))  # noqa: S704 - escaped


def _unbroken(code: str) -> str:
    """Code whose flags are not broken after their dashes at the end of a line."""
    return re.sub(r"(?<!\S)--?[\w-]+", r'<span class="flag">\g<0></span>', code)
