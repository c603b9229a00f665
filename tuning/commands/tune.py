"""`navgym tune`: a study of a filter's parameters, reported on data that nobody tuned on."""

from __future__ import annotations

import time
from collections.abc import Sequence

from navgym.command import as_typed
from navgym.core.interrupts import STOPPED
from navgym.tuning import tune
from navgym.tuning.commands.parse import configured, parse
from navgym.tuning.programs import command as program
from navgym.tuning.report import study as tune_report
from navgym.tuning.settings import StudySettings
from navgym.tuning.study.run import Interrupted

ABOUT = """Find the parameters of a filter, and say how much they gain on data that nobody tuned on.

    navgym tune                                     qivbf on auv/switch-D, about a minute
    navgym tune --scenario auv/heavy --free all     other conditions, every parameter
    navgym tune --filter alignment_mcc --scenario deck/switch-60
    navgym tune --filter kf --log monday.csv --report-log tuesday.csv
    navgym tune --filter kf --log my.csv --read position_noise 5 columns.px "north (m)"
    navgym tune --filter kf --log my.csv --truth smoother   judged against a smoother: circular, see below
    navgym tune --akit FOLDER                       real tracks, tuned without their truth
    navgym tune --config runs/tune/settings.toml --seed 1
    navgym tune --program --help                    any program that replays a log, in place of a filter

1. Optuna varies the free parameters on training recordings; a trial that is surely worse than the
   best is given up on the way. The study is kept on disk: Ctrl-C or a kill loses nothing, and the same
   command goes on. The same seed gives the same result, whatever the number of workers.
2. The leaders are run again on other recordings, and the best of them is chosen there.
3. The winner is compared with the default parameters, with other filters and with the bound on
   recordings that neither step has seen, all on the same ones, so that differences are paired.
4. Writes report.html (open it in a browser), results.json, and tuned.toml, which
   navgym.estimate(filter, recording, "tuned.toml") and the environments' reference= read.

--truth smoother takes what the plain filter (kf) smooths of a log for its truth. That is circular: it
favours the smoother's own filter, model and parameters, and errors that both share show in nothing. On
A-KIT it picked parameters that are as good on three tracks and 9 % worse on the other three than what the
default measure, what the filter foretells, picked there.

--config FILE reads any of the options from a TOML file first, such as the settings.toml that each
study writes; what is given beside it counts. Many machines: see the documentation, Tuning at scale.
"""


def main(words: Sequence[str]) -> int:
    """Tune and report; returns the exit status."""
    if program.wanted(words):
        return program.main(words)
    began = time.perf_counter()
    default, rest = configured(StudySettings, words)
    settings = parse(StudySettings, "tune", ABOUT, rest, default)
    for line in settings.beyond():
        print(line)
    try:
        found = tune.run(settings)
    except Interrupted as stop:
        print(f"\n{tune_report.so_far(settings, stop.outcome)}")
        return STOPPED
    tune_report.write(found, as_typed("tune", words))
    print(f"\n{tune_report.summary(found)}\n{time.perf_counter() - began:.0f} s in all")
    return 0
