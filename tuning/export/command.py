"""`navgym export`: tuned parameters in the format of whoever uses them."""

from __future__ import annotations

import datetime as dt
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from navgym.core.atomic import replacing
from navgym.core.checks import one_of
from navgym.core.storage import read_toml
from navgym.tuning.commands.parse import parse
from navgym.tuning.export import trees
from navgym.tuning.export.formats import FORMATS, Format, number, of_file

LINES = "\n".join(f"    {f.name.ljust(20)}{f.summary}" for f in FORMATS.values())

ABOUT = f"""Take tuned parameters home: in the format of the program that uses them, beside what it has now.

    navgym export runs/program/tuned.toml --as px4 --present old.params --out new.params
    navgym export runs/tune/tuned.toml --as header --out gains.h
    navgym export tuned.toml --as robot_localization --present ekf.yaml --out ekf.yaml \\
        --name accel_noise "process_noise_covariance[12,12]"

What is not tuned stays as the present file has it. What has changed, and what the values rest on, stands in
comments above (JSON has none) and on the terminal. Formats:

{LINES}
"""


@dataclass(frozen=True)
class ExportSettings:
    """What to write.

    Args:
        tuned: a tuned.toml, of a program or of one of our filters.
        format: see above; by default what the ending of --out or --present says.
        present: a file of the target's, whose other values are kept.
        file: to write (default: the terminal).
        name: what the target calls a parameter, such as: accel_noise EKF2_ACC_NOISE
        only: parameters to write; all by default.
    """

    tuned: tyro.conf.Positional[Path]
    format: Annotated[str | None, tyro.conf.arg(name="as")] = None
    present: Path | None = None
    file: Annotated[Path | None, tyro.conf.arg(name="out")] = None
    name: dict[str, str] = field(default_factory=dict)
    only: tuple[str, ...] = ()


@dataclass(frozen=True)
class Change:
    """One value, before and after; `before` is None where it was not there."""

    name: str
    before: Any
    after: Any
    unit: str = ""

    @property
    def line(self) -> str:
        """In words."""
        unit = f" {self.unit}" if self.unit else ""
        if self.before is None:
            return f"{self.name}: new, {_shown(self.after)}{unit}"
        if _alike(self.before, self.after):
            return f"{self.name}: {_shown(self.after)}{unit}, as it was"
        return f"{self.name}: {_shown(self.before)} -> {_shown(self.after)}{unit}"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return str(one) == str(other)
    return math.isclose(float(one), float(other), rel_tol=1e-6)


def export(
    tuned: Path, format_name: str, present: str | None = None, names: Mapping[str, str] | None = None,
    only: Sequence[str] = (),
) -> tuple[str, list[Change]]:  # fmt: skip
    """The text of a file, and what it changes.

    Args:
        tuned: a tuned.toml.
        format_name: a name of `FORMATS`.
        present: text of the target's file; None for none.
        names: what the target calls parameters, beside what the file says.
        only: parameters to write; all by default.

    Raises:
        ValueError: no tuned parameters, an unknown name, a value or a present file that the format does
            not hold.
    """
    told = read_toml(tuned)
    values = told.get("parameters")
    if not isinstance(values, Mapping) or not values:
        raise ValueError(f"{tuned} holds no tuned parameters: it lacks [parameters].")
    for name in (*(names or {}), *only):
        one_of("parameter", name, values)
    targets = {**told.get("targets", {}), **(names or {})}
    form = FORMATS[one_of("format", format_name, FORMATS)]
    kept = {n: v for n, v in values.items() if not only or n in only}
    named = {targets.get(n, n): v for n, v in kept.items()}
    form.check(named)
    units = {targets.get(n, n): u for n, u in told.get("units", {}).items()}
    changes = _changes(form, named, units, present)
    text = form.write(named, [*basis(tuned, told), *(c.line for c in changes)], present)
    _check(form, named, text)
    return text, changes


def _changes(
    form: Format, named: Mapping[str, Any], units: Mapping[str, str], present: str | None
) -> list[Change]:
    try:
        before = {} if present is None else form.read(present)
    except (tomllib.TOMLDecodeError, ValueError) as error:
        raise ValueError(f"--present is no file of format {form.name!r}: {error}") from error
    return [
        Change(n, trees.find(before, n), form.held(v), units.get(n, "")) for n, v in named.items()
    ]


def basis(tuned: Path, told: Mapping[str, Any]) -> list[str]:
    """What the values rest on, in lines."""
    source = told.get("provenance", {})
    version = source.get("versions", {}).get("navgym", "")
    lines = [f"Written by navgym export {version} from {tuned} on {dt.date.today().isoformat()}".replace("  ", " ")]  # fmt: skip
    lines += [f"found by: {source[key]}" for key in ("command",) if key in source]
    lines += [f"{key}: {source[key]}" for key in ("seeds", "sampler", "held") if key in source]
    gains = source.get("gain over defaults", {})
    lines += [f"gain over defaults, {name}: {gain}" for name, gain in gains.items()]
    return lines


def _check(form: Format, named: Mapping[str, Any], text: str) -> None:
    """ValueError unless what was written reads as what was meant."""
    found = form.read(text)
    for name, value in named.items():
        held, back = form.held(value), trees.find(found, name)
        same = form.held(back) == held if not isinstance(held, str) else str(back) == held
        if not same:
            raise ValueError(
                f"{name} = {number(value)} reads back as {back!r} in format {form.name!r}: the present file "
                "holds it in a way that is not known. Leave --present out."
            )


def main(words: Sequence[str]) -> int:
    """Write the file; returns the exit status."""
    settings = parse(ExportSettings, "export", ABOUT, words)
    place = settings.file or settings.present
    if settings.format is None and place is None:
        raise ValueError(f"--as must name a format: {', '.join(FORMATS)}.")
    form = settings.format or of_file(place)
    present = None
    if settings.present is not None:
        try:
            present = settings.present.read_text("utf-8")
        except UnicodeDecodeError:
            raise ValueError(f"--present: {settings.present} is no text.") from None
    text, changes = export(settings.tuned, form, present, settings.name, settings.only)
    if settings.file is None:
        print(text, end="")
        return 0
    with replacing(settings.file, text=True) as file:
        file.write(text)
    print("\n".join(c.line for c in changes))
    print(f"written to {settings.file}")
    return 0
