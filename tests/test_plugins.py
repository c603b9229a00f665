"""A package that brings a filter and a format, as if it were installed."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

PACKAGE = '''
import numpy as np
import navgym
from navgym.core.parameters import Parameter
from navgym.plugins import Plugin


def smooth(recording, parameters):
    """Positions as received, held where they are lost; velocity by their differences."""
    share, z = parameters["share"], recording.measurements
    states, innovations = np.zeros((len(z), 4)), np.full_like(z, np.nan)
    x = np.zeros(4)
    for k, row in enumerate(z):
        heard = np.isfinite(row)
        innovations[k, heard] = (row - x)[heard]
        x = x + share * np.where(heard, row - x, 0.0)
        states[k] = x
    return {"states": states, "innovations": innovations}


def read(path, shift: float = 0.0):
    """A format of two columns."""
    z = np.loadtxt(path, delimiter=" ") + shift
    nothing = np.full(len(z), np.nan)
    return navgym.Recording(
        time=np.arange(len(z), dtype=float), measurements=np.column_stack([z[:, 0], nothing, z[:, 1], nothing]),
        model=navgym.LinearModel(),
    )


FILTER = Plugin("holds and smooths", (Parameter("share", "a", "1", 0.01, 1.0, "log", 0.5),), smooth)
NONE = 3
'''

POINTS = """
[navgym.filters]
auv.smooth_hold = brought:FILTER
auv.broken = brought:NOTHING
auv.kf = brought:FILTER
auv.number = brought:NONE
nameless = brought:FILTER

[navgym.readers]
auv.two_columns = brought:read
"""

USE = """
import pickle, sys, warnings
from pathlib import Path
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    import navgym
    known = navgym.filters()
told = [str(w.message) for w in said]
assert known["smooth_hold"] == "holds and smooths", known
assert any("broken" in t and "cannot be imported" in t for t in told), told
assert any("auv.kf" in t and "already" in t for t in told), told
assert any("auv.number" in t and "no navgym.plugins.Plugin" in t for t in told), told
assert any("nameless" in t and "PROBLEM.NAME" in t for t in told), told
recording = navgym.simulate("auv/switch-D", seed=1, steps=100)
found = navgym.estimate("smooth_hold", recording, {"share": 1.0})
heard = ~__import__("numpy").isnan(recording.measurements[-1])
assert (found.states[-1][heard] == recording.measurements[-1][heard]).all()
from navgym.problem import problem_of
assert pickle.loads(pickle.dumps(problem_of("auv"))) is problem_of("auv")
from navgym.tuning.report import study
from navgym.tuning import tune
from navgym.tuning.settings import StudySettings
asked = StudySettings(filter="smooth_hold", scenario=("auv/mismatch",), trials=2, runs=4, select_runs=4,
                      report_runs=8, steps=100, workers=1, out=Path(sys.argv[1]))
found = tune.run(asked)
assert "smooth_hold, tuned" in study.summary(found)
assert found.reports["auv/mismatch"].errors["smooth_hold, tuned"].shape == (8,)
Path("log.txt").write_text("1 2\\n3 4\\n5 6\\n")
read = navgym.read("two_columns", "log.txt", shift=1.0)
assert read.measurements[2, 2] == 7.0
from navgym.readers import ReaderOptions
assert ReaderOptions((), "two_columns").problem("log.txt").name == "auv"
"""


def test_what_another_package_brings_is_like_ours(tmp_path):
    (tmp_path / "brought.py").write_text(PACKAGE)
    info = tmp_path / "brought-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: brought\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(POINTS)
    where = os.pathsep.join([str(tmp_path), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-c", USE, str(tmp_path / "out")], cwd=tmp_path, text=True, capture_output=True,
        env=os.environ | {"PYTHONPATH": where}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
