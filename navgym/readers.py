"""Real logs as recordings: `navgym.read(format_name, path)`.

A format is a function from a path and keyword options to a recording. Each problem names its own;
one is imported when it is first asked for.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, overload

from navgym.core.checks import one_of
from navgym.problem import load, problems

if TYPE_CHECKING:
    from navgym.deck.recording import DualIMURecording
    from navgym.statespace.recording import Recording

    _Name = str | os.PathLike[str]


def formats() -> dict[str, str]:
    """Where each format's reader is found, "module:function"."""
    return {name: where for p in problems() for name, where in p.readers.items()}


@overload
def read(format_name: Literal["akit", "csv"], path: _Name, /, **options: Any) -> Recording: ...
@overload
def read(
    format_name: Literal["deck_csv", "repoimu", "multi_imu"], path: _Name, /, **options: Any
) -> DualIMURecording: ...
@overload
def read(format_name: str, path: _Name, /, **options: Any) -> Any: ...
def read(format_name: str, path: str | os.PathLike[str], /, **options: Any) -> Any:
    """Read a real log.

    ===========  ===================================  =====================================
    format       holds                                options: see
    ===========  ===================================  =====================================
    "csv"        your own log of positions            `navgym.auv.csv_log.read_csv`
    "akit"       A-KIT: an AUV, six tracks            `navgym.auv.akit.read_akit`
    "deck_csv"   your own log of two IMUs on a deck   `navgym.deck.csv_log.read_deck_csv`
    "repoimu"    RepoIMU: a pendulum's segments       `navgym.deck.public_logs.read_repoimu`
    "multi_imu"  two IMUs on a quadrotor              `navgym.deck.public_logs.read_multi_imu`
    ===========  ===================================  =====================================

    The first two give a `navgym.Recording`, the others a `navgym.deck.recording.DualIMURecording`.

    Args:
        format_name: which.
        path: the file, or the folder of a public data set.
        options: keyword arguments of that function.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: an unknown format or option, or a file that is not in this format.
    """
    known_formats = formats()
    reader: Callable[..., Any] = load(known_formats[one_of("format", format_name, known_formats)])
    known = list(inspect.signature(reader).parameters)[1:]
    for option in options:
        one_of(f"option of format {format_name!r}:", option, known)
    return reader(path, **options)
