"""Formats that parameters are taken home in: each is written, and read for what is there at present.

A name is what the target calls a value. In YAML it may be a path, `node.ros__parameters.gain`, and an
entry of a list, `process_noise_covariance[6,6]`.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.tuning.export import trees

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Format:
    """One format.

    Args:
        name: as given to --as.
        summary: one line for listings.
        ending: of its files.
        write: (values, comments, present text or None) to text.
        read: text to values by name.
        single: whether numbers are kept in single precision.
        names: what a name must look like, and in words.
        text: whether a value may be text.
    """

    name: str
    summary: str
    ending: str
    write: Callable[[Values, Sequence[str], str | None], str]
    read: Callable[[str], dict[str, Any]]
    single: bool = False
    names: tuple[str, str] = (".+", "any text")
    text: bool = True

    def check(self, values: Values) -> None:
        """ValueError for a name or a value that the format cannot hold."""
        for name, each in values.items():
            if not re.fullmatch(self.names[0], name):
                raise ValueError(
                    f"{name!r} is no name in format {self.name!r}, where it must be {self.names[1]}: say "
                    f"what the target calls it, with --name {name} TARGET, or target = in the contract."
                )
            if isinstance(each, str):
                if not self.text:
                    raise ValueError(
                        f"{name} is {each!r}, and format {self.name!r} holds numbers only."
                    )
            elif not abs(each) <= (
                float(np.finfo(np.float32).max) if self.single else sys.float_info.max
            ):
                raise ValueError(f"{name} = {each:g} cannot be held by format {self.name!r}.")

    def held(self, value: Any) -> Any:
        """`value` as the format gives it back."""
        return float(np.float32(value)) if self.single and isinstance(value, float) else value


def number(value: Any, single: bool = False) -> str:
    """A value with all digits that it has, and no more."""
    if isinstance(value, (str, bool)):
        return str(value)
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    return str(np.float32(value)) if single else repr(float(value))


def remarks(comments: Sequence[str], mark: str) -> str:
    """Comments as lines."""
    return "".join(
        f"{mark} {line}".rstrip() + "\n" for each in comments for line in each.splitlines()
    )


# ---- formats of lines: what is not tuned stays as it is


@dataclass(frozen=True)
class Lines:
    """A format with a value per line.

    Args:
        pattern: with groups `name` and `value`.
        made: (name, value) to a new line.
        mark: that begins a comment.
        single: see `Format`.
        head: lines before those of a new file.
        tail: lines after them.
        quoted: whether text stands in quotes.
    """

    pattern: str
    made: Callable[[str, Any], str]
    mark: str
    single: bool = False
    head: str = ""
    tail: str = ""
    quoted: bool = False

    def write(self, values: Values, comments: Sequence[str], present: str | None) -> str:
        """The present text with its values replaced, and what it lacks at its end."""
        left = dict(values)

        def replaced(found: re.Match[str]) -> str:
            name = found["name"]
            if name not in values:
                return found[0]
            left.pop(name, None)
            first, last = (found.span("value")[i] - found.start() for i in (0, 1))
            return f"{found[0][:first]}{self._shown(values[name])}{found[0][last:]}"

        kept = re.sub(self.pattern, replaced, present or "", flags=re.MULTILINE)
        if present is None:
            kept = self.head
        elif kept and not kept.endswith("\n"):
            kept += "\n"
        more = "".join(self.made(name, each) + "\n" for name, each in left.items())
        tail = self.tail if present is None else ""
        if more and present is not None and self.tail and kept.rstrip().endswith("#endif"):
            at = kept.rindex("#endif")
            kept, tail = kept[:at], kept[at:]
        return remarks(comments, self.mark) + kept + more + tail

    def _shown(self, value: Any) -> str:
        return (
            f'"{value}"' if self.quoted and isinstance(value, str) else number(value, self.single)
        )

    def read(self, text: str) -> dict[str, Any]:
        """Values by name."""
        found: dict[str, Any] = {}
        for each in re.finditer(self.pattern, text, flags=re.MULTILINE):
            word = each["value"].strip().strip('"')
            try:
                found[each["name"]] = int(word)
            except ValueError:
                try:
                    found[each["name"]] = float(word.rstrip("fFlL"))
                except ValueError:
                    found[each["name"]] = word
        return found


def _px4_line(name: str, value: Any) -> str:
    kind = 6 if isinstance(value, int) else 9  # MAV_PARAM_TYPE: INT32, REAL32
    return f"1\t1\t{name}\t{number(value, single=True)}\t{kind}"


_NAME = ("[A-Z][A-Z0-9_]{0,15}", "up to 16 capital letters, digits and underscores")
_PX4 = Lines(
    r"^\s*\d+[ \t]+\d+[ \t]+(?P<name>[A-Z][A-Z0-9_]*)[ \t]+(?P<value>\S+)[ \t]+\d+[ \t]*$",
    _px4_line, "#", single=True, head="# Vehicle-Id Component-Id Name Value Type\n",
)  # fmt: skip
_ARDUPILOT = Lines(
    r"^[ \t]*(?P<name>[A-Z][A-Z0-9_]*)[ \t]*[, \t][ \t]*(?P<value>[-+.\deE]+)",
    lambda name, value: f"{name},{number(value, single=True)}", "#", single=True,
)  # fmt: skip


def _define(name: str, value: Any) -> str:
    return f"#define {name} " + (f'"{value}"' if isinstance(value, str) else number(value))


_HEADER = Lines(
    r"^[ \t]*(?:#[ \t]*define[ \t]+|[\w ]*?\b(?:const|constexpr)\b[\w ]*?[ \t])"
    r"(?P<name>[A-Za-z_]\w*)[ \t]*(?:=[ \t]*|[ \t])(?P<value>\"[^\"\n]*\"|[-+]?[\d.][\w.+-]*)",
    _define, "//", head="#ifndef TUNED_PARAMETERS_H\n#define TUNED_PARAMETERS_H\n", tail="#endif\n",
    quoted=True,
)  # fmt: skip


# ---- words of a command line, for programs that read no file


def words(values: Values) -> list[str]:
    """Parameters as words, `-Dname=value`."""
    return [f"-D{name}={number(value)}" for name, value in values.items()]


def _write_words(values: Values, _comments: Sequence[str], _present: str | None) -> str:
    return " ".join(words(values)) + "\n"


def _read_words(text: str) -> dict[str, Any]:
    return _HEADER.read("\n".join(f"#define {w[2:].replace('=', ' ', 1)}" for w in text.split()))


# ---- the register

FORMATS: Mapping[str, Format] = MappingProxyType(
    {
        f.name: f
        for f in (
            Format("toml", "TOML, tables by dots", ".toml", trees.write_toml, lambda t: trees.flat(tomllib.loads(t))),
            Format("json", "JSON, objects by dots; without comments, which it has not", ".json", trees.write_json, lambda t: trees.flat(json.loads(t))),
            Format("yaml", "YAML; what else the present file holds, comments too, is kept", ".yaml", trees.yaml_writer(), trees.read_yaml),
            Format("robot_localization", "ROS 2 YAML; name[i,j] is an entry of a 15 x 15 covariance", ".yaml", trees.yaml_writer("ekf_filter_node.ros__parameters", 15), trees.read_yaml),
            Format("fuse", "ROS 2 YAML; name[i] is an entry of a diagonal of 15", ".yaml", trees.yaml_writer("state_estimator.ros__parameters", 15), trees.read_yaml),
            Format("px4", "PX4 and QGroundControl .params", ".params", _PX4.write, _PX4.read, True, _NAME, False),
            Format("ardupilot", "ArduPilot and Mission Planner .param", ".param", _ARDUPILOT.write, _ARDUPILOT.read, True, _NAME, False),
            Format("header", "a C header", ".h", _HEADER.write, _HEADER.read, False, (r"[A-Za-z_]\w*", "an identifier of C")),
            Format("words", "words of a command line, -Dname=value", ".txt", _write_words, _read_words, False, (r"\w+", "letters, digits and underscores")),
        )
    }
)  # fmt: skip


def of_file(path: Any) -> str:
    """The format that a file's name speaks of; ValueError for none."""
    name = str(path).lower()
    for each in FORMATS.values():
        if name.endswith((each.ending, ".yml" if each.ending == ".yaml" else each.ending)):
            return each.name
    raise ValueError(f"{path} tells no format by its ending: say --as {', '.join(FORMATS)}.")
