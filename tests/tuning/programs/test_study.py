"""A study of a program as a user runs it, and of a function."""

import json
import signal
import sys
import time
import tomllib

import numpy as np
import pytest

from navgym.tuning.programs import report, study
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.settings import ProgramSettings
from tests import commands
from tests.tuning.programs import making
from tests.tuning.programs.test_runner import gone

NOISES = {
    "parameters": {
        "walk_noise": {"range": [0.01, 100.0], "default": 5.0, "unit": "m/√s"},
        "meter_noise": {"range": [0.01, 100.0], "default": 0.5, "unit": "m"},
    }
}


def words(walk, *more, count=6, program="./walk {parameters} {log} {out}"):
    logs = [f"log{i}.csv" for i in range(count)]
    return ("tune", "--program", program, "--parameters", "walk.toml", "--log", *logs, "--workers", "1", *more)


def run(folder, *arguments):
    process = commands.started([sys.executable, "-m", "navgym.command", *map(str, arguments)], folder)
    return commands.ended(process)


def results(folder):
    found = json.loads((folder / "results.json").read_text())
    for machine in ("provenance", "settings", "microseconds per filter step"):
        found.pop(machine)
    return found


@pytest.fixture(scope="module")
def done(walk, tmp_path_factory):
    out = tmp_path_factory.mktemp("done")
    code, text, err = run(walk, *words(walk, "--trials", 24, "--out", out))
    assert code == 0, err
    return out, text


def test_known_noises_are_found_and_the_study_says_how_surely(done):
    out, text = done
    found = tomllib.loads((out / "tuned.toml").read_text())
    for name, true in making.TRUE.items():
        low, high = found["intervals"][name]
        assert low < true < high
        assert low < found["parameters"][name] < high
    assert "95 % interval" in text
    assert "held-out logs: +" in text


def test_no_log_serves_two_ends_and_the_page_says_which_serves_what(done):
    out, text = done
    split = "tuned on log0.csv, log1.csv, log2.csv; chosen among the leaders on log3.csv; reported on log4.csv, log5.csv"
    assert split in text
    assert split.partition(";")[0] in (out / "report.html").read_text()
    about = results(out)["reports"]["held-out logs"]["recordings"]["logs"]
    assert [each.split()[0] for each in about] == ["log4.csv", "log5.csv"]


def test_a_deterministic_program_is_said_to_be_one(done):
    assert "deterministic: 3 runs of the defaults agree in every digit" in done[1]


def test_the_same_command_again_runs_the_program_not_once(done, walk):
    out, _ = done
    kept = {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*.json")}
    before = results(out)
    code, _, err = run(walk, *words(walk, "--trials", 24, "--out", out))
    assert code == 0, err
    assert {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*.json")} == kept
    assert results(out) == before


def test_the_written_settings_and_two_workers_find_the_same(done, walk, tmp_path):
    out, _ = done
    code, _, err = run(walk, "tune", "--config", out / "settings.toml", "--workers", 2, "--out", tmp_path)
    assert code == 0, err
    assert results(tmp_path) == results(out)


def test_killed_and_given_again_it_ends_like_one_that_was_not(done, walk, tmp_path):
    process = commands.started(
        [sys.executable, "-m", "navgym.command", *map(str, words(walk, "--trials", 24, "--out", tmp_path))], walk
    )
    journal, until = tmp_path / "study.log", time.monotonic() + 60
    while time.monotonic() < until and process.poll() is None:
        if journal.exists() and journal.read_text().count('"state":1') >= 6:
            break
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert gone(str(walk / "walk"))
    code, _, err = run(walk, *words(walk, "--trials", 24, "--out", tmp_path))
    assert code == 0, err
    assert results(tmp_path) == results(done[0])


def quick(walk, script, text, *more, count=3, python=True):
    path = script(text, python=python)
    arguments = words(walk, "--trials", 8, "--repeats", 2, *more, count=count, program=f"{path} {{parameters}} {{log}} {{out}}")
    return run(walk, *arguments)


CALLED = """
import subprocess, sys, tomllib
told = tomllib.load(open(sys.argv[1], "rb"))
def walk(text=None):
    open("mine.toml", "w").write(text or open(sys.argv[1]).read())
    subprocess.run([WALK, "mine.toml", *sys.argv[2:]], check=True)
""".strip()  # fmt: skip


def called(walk, text):
    return CALLED.replace("WALK", repr(str(walk / "walk"))) + "\n" + text


def test_runs_that_fail_are_counted_shown_and_never_fatal(walk, script, tmp_path):
    text = called(
        walk,
        "if told['walk_noise'] > 8: sys.exit('the filter lost its track')\n"
        "if told['meter_noise'] > 10:\n    open(sys.argv[3], 'w').write('what?')\n    sys.exit()\nwalk()",
    )
    code, out, err = quick(walk, script, text, "--out", tmp_path)
    assert code == 0, err
    assert "runs of the trials failed" in out
    assert "exit status 1" in out
    page = (tmp_path / "report.html").read_text()
    assert "the filter lost its track" in page
    failed = results(tmp_path)["failed runs"]
    assert failed["exit status 1"] >= 3
    trials = results(tmp_path)["trials"]
    assert all(np.isfinite(t["result"]) for t in trials)


def test_a_parameter_that_the_program_ignores_is_named(walk, script, tmp_path):
    text = called(walk, "walk('walk_noise = %r\\nmeter_noise = 2.0\\n' % told['walk_noise'])")
    code, out, err = quick(walk, script, text, "--out", tmp_path)
    assert code == 0, err
    assert "The program ignores meter_noise" in out
    assert results(tmp_path)["ignored"] == ["meter_noise"]


def test_a_program_that_says_something_else_each_time_is_measured(walk, script, tmp_path):
    text = called(
        walk,
        "import random\nq = told['walk_noise'] * (1 + random.gauss(0, .2))\n"
        "walk('walk_noise = %r\\nmeter_noise = %r\\n' % (abs(q), told['meter_noise']))",
    )
    code, out, err = quick(walk, script, text, "--out", tmp_path)
    assert code == 0, err
    assert "The program is not deterministic: over 2 runs" in out
    assert "cannot be told from chance" in out
    assert results(tmp_path)["repeats"]["deviation"] > 0.0


def test_a_filter_that_drops_what_it_does_not_like_does_not_win(walk, script, tmp_path):
    text = called(
        walk,
        "walk()\nif told['walk_noise'] < 1:\n"
        "    rows = open(sys.argv[3]).read().splitlines()\n"
        "    open(sys.argv[3], 'w').write('\\n'.join(rows[: len(rows) // 2]) + '\\n')",
    )
    code, out, err = quick(walk, script, text, "--range", "walk_noise", 0.5, 20, "--out", tmp_path)
    assert code == 0, err
    assert "too few rows" in out or results(tmp_path)["failed runs"] == {}
    assert tomllib.loads((tmp_path / "tuned.toml").read_text())["parameters"]["walk_noise"] >= 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sys.exit('I need a licence')", "gives nothing to judge at its default parameters, on any log. log0.csv: exit status 1: I need a licence"),
        ("open(sys.argv[3], 'w').write('%PDF')", "garbage"),
        ("walk() if '0' in sys.argv[2][-6:] else open(sys.argv[3], 'w').write('time,nis\\n0,1\\n1,1\\n')", "are logs of different kinds"),
    ],
)  # fmt: skip
def test_a_program_that_gives_nothing_to_judge_is_said_so_at_once(walk, script, tmp_path, text, message):
    code, _, err = quick(walk, script, called(walk, text), "--out", tmp_path)
    assert code == 2
    assert message in " ".join(err.split())
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--measure", "rmse"), "measure 'rmse' needs columns that the program does not write"),
        (("--free", "proces"), "Did you mean 'process'"),
        (("--fix", "walk_noise", "1", "meter_noise", "1"), "every parameter is fixed"),
        (("--report-log", "log0.csv"), "serves two ends"),
        (("--log", "nowhere.csv"), "no log at nowhere.csv"),
        (("--range", "walk_noise", "5", "1"), "must be low < high"),
        (("--prior",), "no free parameter declares one"),
    ],
)
def test_what_does_not_fit_is_said_with_the_remedy(walk, tmp_path, more, message):
    code, _, err = run(walk, *words(walk, "--trials", 2, "--out", tmp_path), *more)
    assert code == 2
    assert message in " ".join(err.replace("│", " ").split())


def test_one_log_is_cut_in_time_and_it_is_said(walk, tmp_path):
    code, out, err = run(walk, *words(walk, "--trials", 8, "--free", "process", "--out", tmp_path, count=1))
    assert code == 0, err
    assert "each log is cut in time: tuned on the first 50%" in out
    assert "judge better" in out
    assert tomllib.loads((tmp_path / "tuned.toml").read_text())["parameters"]["meter_noise"] == 0.5


# ---- functions


def tuned(out, call, recordings, **more):
    options = {"trials": 16, "repeats": 2, "workers": 1, "out": out, "name": "mine"} | more
    found = study.run(ProgramSettings(**options), call, recordings, Contract.of_dict(NOISES))
    report.write(found)
    return found


def three(first, **more):
    made = [making.series(first + i, **more) for i in range(4)]
    return {"log": made[:2], "select_log": made[2:3], "report_log": made[3:]}


def test_a_function_is_tuned_like_a_program(tmp_path):
    found = tuned(tmp_path, making.kalman, three(10))
    for name, true in making.TRUE.items():
        low, high = found.fit.intervals[name]
        assert low < true < high
    assert found.reports["held-out logs"]["mine, tuned"].gain > 0.1
    assert {p.name for p in tmp_path.iterdir()} >= {"report.html", "results.json", "tuned.toml", "study.log"}


def test_a_function_that_raises_fails_a_run_and_no_study(tmp_path):
    def touchy(recording, parameters):
        if parameters["walk_noise"] > 6.0:
            raise ZeroDivisionError("of course")
        return making.kalman(recording, parameters)

    found = tuned(tmp_path, touchy, three(20))
    assert found.failures["ZeroDivisionError"] > 0
    assert "of course" in found.examples["ZeroDivisionError"]


def test_a_prior_draws_the_result_towards_it(tmp_path):
    strong = {n: t | {"prior": 1.05} for n, t in NOISES["parameters"].items()}
    contract = Contract.of_dict({"parameters": strong})
    options = {"trials": 16, "repeats": 1, "workers": 1}
    recordings = three(30, steps=60)
    free = study.run(ProgramSettings(**options, out=tmp_path / "free"), making.kalman, recordings, contract)
    held = study.run(ProgramSettings(**options, prior=True, out=tmp_path / "held"), making.kalman, recordings, contract)
    assert free.fit.values["walk_noise"] < held.fit.values["walk_noise"] < 5.0
    with pytest.raises(ValueError, match="--prior needs a likelihood"):
        study.run(ProgramSettings(**options, prior=True, measure="one_step", out=tmp_path / "no"), making.kalman, recordings, contract)


def test_the_error_against_a_reference_can_be_minimised(tmp_path):
    def smoother(recording, parameters):
        time, z = recording
        share, x, found = parameters["walk_noise"] / 101.0, 0.0, []
        for value in z:
            x += share * (value - x)
            found.append(x)
        return {"time": time, "estimate": np.array(found), "reference": 0.02 * time}

    recordings = {
        name: [(t, 0.02 * t + np.random.default_rng(i).standard_normal(len(t))) for i, t in each]
        for name, each in {
            "log": [(0, np.arange(300.0))], "select_log": [(1, np.arange(300.0))], "report_log": [(2, np.arange(300.0))],
        }.items()
    }  # fmt: skip
    found = tuned(tmp_path, smoother, recordings, free=("walk_noise",))
    report_ = found.reports["held-out logs"]
    assert found.measure.name == "rmse"
    assert report_["mine, tuned"].mean < report_["mine, default"].mean
