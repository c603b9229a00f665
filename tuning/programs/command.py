"""`navgym tune --program`: a study of somebody's program."""

from __future__ import annotations

import time
from collections.abc import Sequence

from navgym.command import as_typed
from navgym.core.interrupts import STOPPED
from navgym.tuning.commands.parse import configured, parse
from navgym.tuning.programs import report, study
from navgym.tuning.programs.settings import ProgramSettings
from navgym.tuning.report import study as tune_report
from navgym.tuning.study.run import Interrupted

FLAG = "--program"

ABOUT = """Tune any program that replays a log: Kalman filter, observer, replay tool, script.

    navgym tune --program "./replay {parameters} {log} {out}" --parameters gains.toml --log a.csv b.csv c.csv
    navgym tune --program "python replay.py {parameters} {log} {out}" --parameters gains.toml --log monday.csv
    navgym tune --program "./replay {parameters} {log} {out}" --parameters gains.toml --log a.bin \\
        --select-log b.bin --report-log c.bin d.bin

The program is told a file of parameters and a log, and writes a CSV to {out}: a column time (s), and
innovation and variance (innovation_x, innovation_y, variance_x, ...), or nis, or log_likelihood, or estimate
and reference. gains.toml declares the parameters:

    format = "toml"             # or json, yaml, px4, ardupilot, header, words (-Dname=value)
    [parameters.accel_noise]
    unit = "m/s²"
    range = [0.01, 100.0]
    default = 1.0

The study is that of our own filters: logs that choose and logs that judge are not tuned on, bad trials are given
up on the way, dead knobs are named, nothing is lost by a kill. A run that crashes, hangs, forks, fills the
disk or writes garbage is killed, counted and shown. Runs are kept in OUT/runs, and none is made twice.
"""


def wanted(words: Sequence[str]) -> bool:
    """Whether a command line is about a program: it says so, or the file of settings that it names does."""
    if any(word == FLAG or word.startswith(f"{FLAG}=") for word in words):
        return True
    if "--config" not in words[:-1]:
        return False
    from navgym.core.storage import read_toml

    return "program" in read_toml(words[list(words).index("--config") + 1])


def main(words: Sequence[str]) -> int:
    """Tune and report; returns the exit status."""
    began = time.perf_counter()
    given = [
        w
        for i, w in enumerate(words)
        if not (w == FLAG and words[i + 1 : i + 2] in ([], ["--help"], ["-h"]))
    ]
    default, rest = configured(ProgramSettings, given)
    settings = parse(ProgramSettings, "tune", ABOUT, rest, default)
    try:
        found = study.run(settings)
    except Interrupted as stop:
        print(f"\n{tune_report.so_far(settings, stop.outcome)}")
        return STOPPED
    report.write(found, as_typed("tune", words))
    print(f"\n{report.summary(found)}\n{time.perf_counter() - began:.0f} s in all")
    return 0
