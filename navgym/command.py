"""The console command `navgym`: one word says what to do, everything after it is that command's.

    navgym tune --help

A command is imported when it is asked for: the others' packages need not be installed. Its function
takes the words after its name, returns the exit status, and raises ValueError or OSError for input
that cannot be: what is said then, and the exit status, are decided here, once.
"""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata

from navgym.core import streams
from navgym.core.checks import one_of
from navgym.core.interrupts import STOPPED

WRONG = 2  # exit status for input that cannot be
UNREAD = 141  # exit status where nobody reads the output any more, as shells have it

_STUDY = "stopped: finished trials are kept, the same command goes on from there"
_TRAINING = "stopped: the same command, without --fresh, goes on from the last checkpoint"


@dataclass(frozen=True)
class Command:
    """One word of the command line.

    Args:
        where: "module:function"; the function takes the words after it and returns the exit status.
        what: one line for listings.
        extra: of the package that it needs, "" for none.
        stopped: what Ctrl-C means, where the command does not say it itself; "" for nothing.
    """

    where: str
    what: str
    extra: str = ""
    stopped: str = "stopped"


COMMANDS = {
    "demo": Command(
        "navgym.tuning.commands.demo:main",
        "tune, compare every filter, replay tracks, write a page", "tuning",
    ),
    "inspect": Command(
        "navgym.inspect_command:main", "say what is in a log, what is wrong with it, and what to run next"
    ),
    "read": Command("navgym.read_command:main", "say what a log holds, before anything is made of it"),
    "tune": Command(
        "navgym.tuning.commands.tune:main",
        "find a filter's parameters, for simulated conditions or your own logs", "tuning", _STUDY,
    ),
    "export": Command(
        "navgym.tuning.export.command:main",
        "take tuned parameters home, in the format of the program that uses them", "tuning",
    ),
    "headroom": Command(
        "navgym.tuning.commands.headroom:main",
        "what steering a filter could win at most", "tuning", _STUDY,
    ),
    "reproduce": Command(
        "navgym.tuning.commands.reproduce:main",
        "run two papers' figures again, and say which of them hold", "tuning",
    ),
    "train": Command(
        "navgym.agents.training.command:main",
        "train a policy that sets a filter's parameters while it runs", "agents", _TRAINING,
    ),
    "combine": Command(
        "navgym.agents.combiner.command:main",
        "train a network that weighs the modes of the bank", "agents", _TRAINING,
    ),
    "retune": Command(
        "navgym.agents.mixture.retune_command:main",
        "which settings a recording's own fixes choose, afterwards", "tuning",
    ),
    "evaluate": Command(
        "navgym.agents.evaluation.command:main",
        "what a policy is worth, beside every simpler way", "tuning", "stopped: nothing was written",
    ),
    "stream": Command(
        "navgym.agents.live.command:main",
        "filter a log line by line, as it arrives, by a policy", stopped="",
    ),
    "benchmark": Command(
        "navgym.tuning.commands.benchmark:main",
        "how fast it is, as ratios measured in one run", "tuning",
    ),
    "warm": Command("navgym.warm:main", "compile kernels now, instead of at first use"),
}  # fmt: skip


def main(words: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        words: the command and what follows it; those of this process by default.

    Returns the exit status: the command's own, 2 for input that cannot be and for output that cannot
    be written, 130 after Ctrl-C, 141 where nobody reads the output any more.
    """
    streams.prepare()
    try:
        status = _begin(list(sys.argv[1:] if words is None else words))
    except (SystemExit, OSError):  # of a parser of words, after it has said why; of print
        if lost := streams.lost():
            return _unwritten(lost)
        raise
    lost = streams.lost()
    return status if lost is None else _unwritten(lost)


def _begin(given: Sequence[str]) -> int:
    if not given or given[0] in ("-h", "--help"):
        print(listing())
        return 0
    if given[0] == "--version":
        from navgym import __version__

        print(f"navgym {__version__}")
        return 0
    try:
        command = COMMANDS[one_of("command", given[0], COMMANDS)]
    except ValueError as error:
        return _wrong(error)
    return _run(command, given[1:])


def as_typed(name: str, words: Sequence[str]) -> str:
    """A command as it was given, for the record."""
    return shlex.join(["navgym", name, *words])


def listing() -> str:
    """What there is, a line each."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name.ljust(width)}  {command.what}" for name, command in COMMANDS.items()]
    head, tail = "usage: navgym COMMAND ...", "navgym COMMAND --help teaches each; navgym --version"
    return "\n".join([head, "", *lines, "", tail])


def _run(command: Command, words: Sequence[str]) -> int:
    module, _, function = command.where.partition(":")
    try:
        status: int = getattr(importlib.import_module(module), function)(words)
    except ImportError as error:
        return _wrong(_remedy(error, command))
    except OSError as error:
        lost = streams.lost()  # then it is what this is about
        return _wrong(_plain(error)) if lost is None else _unwritten(lost)
    except ValueError as error:
        return _wrong(error)
    except MemoryError:
        return _wrong("there is not enough memory for this: take less data at a time.")
    except KeyboardInterrupt:
        if command.stopped:
            print(f"\n{command.stopped}", file=sys.stderr)
        return STOPPED
    return status


def _wrong(what: object) -> int:
    print(f"error: {what}", file=sys.stderr)
    return WRONG


def _plain(error: OSError) -> str:
    """An error of the system without its number, the file first."""
    if error.errno is None or error.strerror is None:
        return str(error)
    return f"{error.filename}: {error.strerror}" if error.filename else error.strerror


def _unwritten(error: OSError) -> int:
    """The exit status where standard output cannot be written, having said so if that may help."""
    if isinstance(error, BrokenPipeError):
        return UNREAD
    return _wrong(f"standard output cannot be written ({error.strerror}).")


def _remedy(error: ImportError, command: Command) -> str:
    """What to install; raises `error` again where that would not help."""
    if error.name is None:  # navgym's own words
        return str(error)
    package = error.name.partition(".")[0]
    if not isinstance(error, ModuleNotFoundError) or package == "navgym":
        raise error
    extra = _extra(package, command.extra)
    wanted = f"navgym[{extra}]" if extra else "navgym"
    return f"this needs the package {package}: pip install '{wanted}'"


# modules that are called otherwise than what is installed
_INSTALLED_AS = {"sklearn": "scikit-learn"}


def _extra(package: str, usual: str) -> str:
    """The extra of navgym that asks for a package; `usual` if that does, or none."""
    wanted = _INSTALLED_AS.get(package, package).replace("_", "-").lower()
    asked: dict[str, set[str]] = {}  # by extra: packages, and navgym[other] for what it includes
    for line in metadata.requires("navgym") or ():
        found = re.match(r"([\w.-]+(?:\[\w+\])?).*extra == ['\"](\w+)['\"]", line)
        if found:
            asked.setdefault(found[2], set()).add(found[1].replace("_", "-").lower())
    having = {extra for extra, packages in asked.items() if wanted in packages}
    within = {extra for extra in having if f"navgym[{extra}]" in asked.get(usual, ())}
    return usual if not having or usual in having or within else min(having)


if __name__ == "__main__":  # as a module of its own name, which the commands import too
    from navgym.command import main as _main

    sys.exit(_main())
