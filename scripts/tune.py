"""Find the parameters of a filter, and say how much they gain on data that nobody tuned on.

    python scripts/tune.py                                  qivbf on auv/switch-D, about a minute
    python scripts/tune.py --scenario auv/heavy --free all  other conditions, every parameter
    python scripts/tune.py --filter alignment_mcc --scenario deck/switch-60
    python scripts/tune.py --filter kf --log monday.csv --report-log tuesday.csv
    python scripts/tune.py --akit FOLDER                    real tracks, tuned without their truth
    python scripts/tune.py --config runs/tune/settings.toml --seed 1

1. Optuna varies the free parameters on training recordings; a trial that is surely worse than the
   best is given up on the way. The study is kept on disk: Ctrl-C or a kill loses nothing, and the same
   command goes on. The same seed gives the same result, whatever the number of workers.
2. The leaders are run again on other recordings, and the best of them is chosen there.
3. The winner is compared with the default parameters, with other filters and with the bound on
   recordings that neither step has seen, all on the same ones, so that differences are paired.
4. Writes report.html (open it in a browser), results.json, and tuned.toml, which
   navgym.estimate(filter, recording, "tuned.toml") and the environments' reference= read.

Many machines: docs/tuning-at-scale.md.
"""

from __future__ import annotations

import sys
import time


def main() -> int:
    """Tune and report; returns the exit status."""
    from navgym.tuning import tune
    from navgym.tuning.commands import parse as command
    from navgym.tuning.report import study as tune_report
    from navgym.tuning.settings import StudySettings

    began = time.perf_counter()
    try:
        settings = command.parse(StudySettings, __doc__)
        found = tune.run(settings)
        tune_report.write(found)
        print(f"\n{tune_report.summary(found)}\n{time.perf_counter() - began:.0f} s in all")
    except tune.Interrupted as stop:
        print(f"\n{tune_report.so_far(settings, stop.outcome)}")
        return 130
    except KeyboardInterrupt:
        print("\nstopped: finished trials are kept, the same command goes on from there")
        return 130
    except (ValueError, OSError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
