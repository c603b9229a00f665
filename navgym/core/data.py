"""Where public recordings lie on this machine: a folder that the user names."""

from __future__ import annotations

import os
from pathlib import Path

VARIABLE = "NAVGYM_DATA"  # of the environment: a folder that holds some of SETS
SETS = ("akit", "repoimu", "multi_imu")


def data_folder(name: str, given: Path | None = None) -> Path | None:
    """Folder of the data set `name`: in the folder that was named, else in $NAVGYM_DATA.

    Args:
        name: such as "akit".
        given: by --data: the data set's own folder, or one that holds it under its name.

    Returns None where nothing was named, or what was named is another data set, or holds only others.

    Raises:
        ValueError: a folder was named, and there is none.
    """
    if given is not None and not given.is_dir():
        raise ValueError(f"--data must be a folder of recordings: {given} is none.")
    base = given if given is not None else base_folder()
    if base is None:
        return None
    if (base / name).is_dir():
        return base / name
    others = [other for other in SETS if other != name]
    foreign = base.resolve().name in others or any((base / other).is_dir() for other in others)
    return None if foreign or given is None else base


def base_folder() -> Path | None:
    """The folder that $NAVGYM_DATA names, None where it is not set; ValueError if there is none."""
    named = os.environ.get(VARIABLE)
    if named and not Path(named).is_dir():
        raise ValueError(f"${VARIABLE} must be a folder of recordings: {named} is none.")
    return Path(named) if named else None


def absent(*titles: str) -> str:
    """A line that says which data sets are left out, and what to do."""
    return f"no {', '.join(titles)} data: left out (name their folder with --data or ${VARIABLE})"
