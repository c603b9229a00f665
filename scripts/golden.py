"""Say whether a change has changed any result: compare with the golden outputs in tests/golden.

    python scripts/golden.py                         compare everything; half a minute
    python scripts/golden.py --only filter/auv       what begins so
    python scripts/golden.py --write                 the results are meant to change: write them anew

The golden outputs are of every filter on every scenario, roll-outs of every environment, live
filters, studies, trainings, readers, identification and metrics. On the platform that wrote them
they are compared bit by bit, elsewhere to a tolerance (tests/golden/book.py). The exit status is 1
if anything has changed. Commit what --write has written together with the reason.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for `tests`


def main() -> int:
    """Compare or write; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="write what is computed now")
    parser.add_argument("--only", default="", metavar="PREFIX", help="of the keys to look at")
    chosen = parser.parse_args()
    from tests.golden import rooms  # takes seconds

    began, changed = time.perf_counter(), 0
    try:
        for room in rooms.ROOMS:
            changed += _visit(room, chosen.only, chosen.write)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    written = ", and everything written anew" if chosen.write else ""
    print(f"{changed} entries changed{written}; {time.perf_counter() - began:.0f} s")
    return 0 if chosen.write else int(changed > 0)


def _visit(room: str, only: str, write: bool) -> int:
    """Compare or write one room; returns how many entries have changed."""
    from tests.golden import book, rooms

    if not (room.startswith(only) or only.startswith(f"{room}/")):
        return 0
    platform, old = book.read(room)
    old_here = {key: line for key, line in old.items() if key.startswith(only)}
    began = time.perf_counter()
    new = book.lines_of(rooms.entries(room), only)
    same = platform == book.here()
    if write and not same and len(old_here) < len(old):
        raise ValueError(
            f"{book.path_of(room).name} was written on another platform, and a file is of one: "
            "leave out --only."
        )
    found = book.changes(old_here, new, same)
    how = "bits" if same else "summaries (another platform)"
    print(f"{room}: {len(new)} entries, {how}, {time.perf_counter() - began:.1f} s", flush=True)
    for key, (before, after) in found.items() if old else ():
        print(book.shown(key, before, after))
    if write:
        book.write(room, {k: v for k, v in old.items() if k not in old_here} | new)
    return len(found)


if __name__ == "__main__":
    sys.exit(main())
