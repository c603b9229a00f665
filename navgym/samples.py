"""A log to try things on, which comes with the package."""

from __future__ import annotations

from pathlib import Path


def sample_log() -> Path:
    """A text log of a simulated vehicle, with what loggers do to logs: see its first lines.

    Latitude and longitude with decimal commas, dates, a fast logger that holds the last fix, rows that came late,
    velocities in knots and a word for what is missing. `navgym.read("csv", navgym.sample_log())` reads it as it is.
    """
    return Path(__file__).with_name("sample_log.csv")
