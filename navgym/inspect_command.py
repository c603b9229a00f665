"""`navgym inspect`: what is in a log, what is wrong with it, and what to do next."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from navgym.core.atomic import replacing
from navgym.core.notes import Progress
from navgym.inspection.findings import Inspection
from navgym.inspection.inspect import of
from navgym.log_command import log_parser, parse
from navgym.problem import load
from navgym.readers import ReaderOptions

ABOUT = """Look a log over: what it holds, what is wrong with it, what noise it suggests, and what to run next.

    navgym inspect my_log.csv
    navgym inspect my_log.csv --page my_log.html              # with plots; needs navgym[tuning]
    navgym inspect my_log.csv --json - | jq .findings         # for programs
    navgym inspect my_log.csv --read mapping.toml position_noise 1.5

--read is as for navgym read. Exit status: 0 nothing was found, 1 something was, 2 the log cannot be read as
it is: that is said as a finding too, and how the reader can be told to read it.
"""

NO_COMMAND = "no command helps before the file is mended as the errors say"
PAGE = "navgym.tuning.report.inspection:write"  # needs matplotlib and jinja2
NAMED = 10  # columns of the line's name


def command_line(words: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = log_parser("navgym inspect", ABOUT)
    add = parser.add_argument
    add("--json", metavar="FILE", help="write all of it as JSON, to FILE or, for -, to the output")
    add("--page", type=Path, metavar="FILE", help="write a page with plots, NAME.html")
    return parse(parser, words)


def main(words: Sequence[str]) -> int:
    """Look and tell; returns the exit status."""
    asked = command_line(words)
    with Progress(f"inspecting {asked.log.name}"):
        found = of(asked.log, ReaderOptions.parsed(asked.read, asked.format))
    if asked.json == "-":
        print(_json(found))
        return found.status
    for line in lines(found):
        print(line)
    if asked.json:
        with replacing(Path(asked.json), text=True) as file:
            file.write(_json(found) + "\n")
        print(f"{'json'.ljust(NAMED)} {asked.json}")
    if asked.page is not None:
        print(f"{'page'.ljust(NAMED)} {load(PAGE)(asked.page, found)}")
    print(f"{'next'.ljust(NAMED)} {found.next or NO_COMMAND}")
    return found.status


def lines(found: Inspection) -> list[str]:
    """What a terminal shows, but for the command to run next."""
    told = [*found.told, *(("losses", f"{each.sensor}: {each.words}") for each in found.losses)]
    told += [("noise", f"{name} {text}") for name, text in found.noise]
    said = [f"{name.ljust(NAMED)} {text}" for name, text in told]
    if not found.findings:
        return [*said, f"{'findings'.ljust(NAMED)} none"]
    for each in found.findings:
        where = f"{each.channel}: " * bool(each.channel) * (not each.said.startswith(each.channel))
        said.append(f"{each.severity.ljust(NAMED)} {each.kind}: {where}{each.said.rstrip('.')}")
        if each.remedy:
            said.append(f"{'':{NAMED}}   {each.remedy}")
    return said


def _json(found: Inspection) -> str:
    return json.dumps(found.as_dict(), indent=1, ensure_ascii=False, allow_nan=False)
