"""What `navgym read` and `navgym inspect` share: how a log and its reader are named.

By argparse: the core of navgym does not install tyro.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from navgym.readers import formats, words_after


def log_parser(command: str, about: str) -> argparse.ArgumentParser:
    """A parser that takes a log, --read and --format; `parse` uses it.

    Args:
        command: as it is typed.
        about: what --help says.
    """
    parser = argparse.ArgumentParser(
        prog=command, description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("log", type=Path, help="the file, or the folder of a public data set")
    add(
        "--read",
        nargs="+",
        metavar="WORD",
        default=argparse.SUPPRESS,
        help="what the reader is told",
    )
    add("--format", help=f"one of {', '.join(formats())}; by default what the log looks like")
    return parser


def parse(parser: argparse.ArgumentParser, words: Sequence[str]) -> argparse.Namespace:
    """The command line; the reader's words, which may begin with a minus, are `read`."""
    told, rest = words_after("--read", words)
    return parser.parse_args(rest, argparse.Namespace(read=told))
