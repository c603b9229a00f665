"""A study of a program as a user runs it, and of a function."""

import contextlib
import io
import json
import signal
import sys
import time
import tomllib

import numpy as np
import pytest

from navgym.tuning.programs import command, report, study
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.settings import ProgramSettings
from tests import commands
from tests.browser import check, needs_browser
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
    return (
        "tune",
        "--program",
        program,
        "--parameters",
        "walk.toml",
        "--log",
        *logs,
        "--workers",
        "1",
        *more,
    )


def run(folder, *arguments):
    """Exit status, output and errors of `navgym`, in this process."""
    said = io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        try:
            return command.main([str(word) for word in arguments[1:]]), said.getvalue(), ""
        except (ValueError, OSError) as error:
            return 2, said.getvalue(), str(error)
        except SystemExit:
            return 2, said.getvalue(), err.getvalue()


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


@needs_browser
def test_the_page_fits_in_a_browser(done, tmp_path):
    check([done[0] / "report.html"], tmp_path)


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
    code, _, err = run(
        walk, "tune", "--config", out / "settings.toml", "--workers", 2, "--out", tmp_path
    )
    assert code == 0, err
    assert results(tmp_path) == results(out)


def test_killed_and_given_again_it_ends_like_one_that_was_not(done, walk, tmp_path):
    process = commands.started(
        [
            sys.executable,
            "-m",
            "navgym.command",
            *map(str, words(walk, "--trials", 24, "--out", tmp_path)),
        ],
        walk,
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


def quick(walk, script, text, out, count=3, **more):
    """A small study of a script around the program, and what its report says of the program."""
    path = script(f"walk={walk / 'walk'}\n{SHELL}\n{text}")
    options = {"trials": 8, "repeats": 2, "workers": 1, "out": out} | more
    found = study.run(
        ProgramSettings(
            program=f"{path} {{parameters}} {{log}} {{out}}", parameters=walk / "walk.toml",
            log=tuple(walk / f"log{i}.csv" for i in range(count)), **options,
        )
    )  # fmt: skip
    return found, "\n".join(report.said(found))


SHELL = """
q=$(sed -n "s/walk_noise = //p" "$1")
r=$(sed -n "s/meter_noise = //p" "$1")
is() { awk "BEGIN { exit !($1) }"; }
""".strip()


def test_runs_that_fail_are_counted_shown_and_never_fatal(walk, script, tmp_path):
    text = (
        'if is "$q > 8"; then echo the filter lost its track >&2; exit 1; fi\n'
        'if is "$r > 10"; then echo what? > $3; echo ever >> $3; exit; fi\n'
        'if is "$q < 0.05"; then sleep 60; fi\n$walk $1 $2 $3'
    )
    found, said = quick(walk, script, text, tmp_path, time_limit=1.0, prune=False, trials=20)
    report.write(found)
    assert "runs of the trials failed" in said
    assert "the filter lost its track" in (tmp_path / "report.html").read_text()
    failed = results(tmp_path)["failed runs"]
    assert {"exit status 1", "garbage", "time-out"} <= set(failed)
    told = "; ".join(line for t in results(tmp_path)["trials"] for line in t["failed"])
    assert told.count("the filter lost its track") == failed["exit status 1"]
    assert all(np.isfinite(t["result"]) for t in results(tmp_path)["trials"])


def test_a_parameter_that_the_program_ignores_is_named(walk, script, tmp_path):
    text = 'printf "walk_noise = $q\\nmeter_noise = 2.0\\n" > mine; $walk mine $2 $3'
    found, said = quick(walk, script, text, tmp_path, trials=4)
    assert "The program ignores meter_noise" in said
    assert report.ignored(found) == ["meter_noise"]


def test_a_program_that_says_something_else_each_time_is_measured(walk, script, tmp_path):
    text = (
        "n=$(od -An -N1 -tu1 /dev/urandom)\n"
        'printf "walk_noise = $(awk "BEGIN { print $q * (1 + $n / 256) }")\\nmeter_noise = $r\\n" > mine\n'
        "$walk mine $2 $3"
    )
    found, said = quick(walk, script, text, tmp_path, trials=4)
    assert "The program is not deterministic: over 2 runs" in said
    assert "cannot be told from chance" in said
    assert found.twice.seen > 0.0


def test_a_filter_that_drops_what_it_does_not_like_does_not_win(walk, script, tmp_path):
    text = '$walk $1 $2 $3; if is "$q < 1"; then head -n 200 $3 > half; mv half $3; fi'
    found, said = quick(walk, script, text, tmp_path, range={"walk_noise": (0.5, 20.0)})
    assert "too few rows" in said
    assert found.values["walk_noise"] >= 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("echo I need a licence >&2; exit 1", "gives nothing to judge at its default parameters, on any log. log0.csv: exit status 1: I need a licence"),
        ("printf '%%PDF\\n%%%%EOF\\n' > $3", "garbage"),
        ('case $2 in *0.csv) $walk $1 $2 $3;; *) printf "time,nis\\n0,1\\n1,1\\n" > $3;; esac', "are logs of different kinds"),
    ],
)  # fmt: skip
def test_a_program_that_gives_nothing_to_judge_is_said_so_at_once(
    walk, script, tmp_path, text, message
):
    with pytest.raises(ValueError, match=message):
        quick(walk, script, text, tmp_path)


def test_a_log_on_which_the_defaults_fail_is_left_out_and_named(walk, script, tmp_path):
    text = "case $2 in *1.csv) echo damaged >&2; exit 1;; esac; $walk $1 $2 $3"
    _, said = quick(walk, script, text, tmp_path, count=5, trials=4)
    assert "Left out: log1.csv, where the defaults fail: exit status 1: damaged" in said


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


def test_a_copy_of_a_log_cannot_judge(walk, tmp_path):
    (tmp_path / "copy.csv").write_bytes((walk / "log0.csv").read_bytes())
    code, _, err = run(walk, *words(walk, "--report-log", tmp_path / "copy.csv", "--out", tmp_path))
    assert code == 2
    assert "a copy cannot judge" in err


def test_one_log_is_cut_in_time_and_it_is_said(walk, script, tmp_path):
    found, _ = quick(walk, script, "$walk $1 $2 $3", tmp_path, count=1, trials=4, free=("process",))
    assert "each log is cut in time: tuned on the first 50%" in found.stages.split
    assert "judge better" in found.stages.split
    assert found.winner["meter_noise"] == 0.5
    assert [p[0].span for p in (found.stages.train["logs"], found.stages.report["logs"])] == [
        (0, 120),
        (168, 240),
    ]


# ---- functions


def tuned(out, call, recordings, **more):
    options = {"trials": 16, "repeats": 2, "workers": 1, "out": out, "name": "mine"} | more
    return study.run(ProgramSettings(**options), call, recordings, Contract.of_dict(NOISES))


def three(first, **more):
    made = [making.series(first + i, **more) for i in range(4)]
    return {"log": made[:2], "select_log": made[2:3], "report_log": made[3:]}


def test_a_function_is_tuned_like_a_program(tmp_path):
    found = tuned(tmp_path, making.kalman, three(10))
    report.write(found)
    for name, true in making.TRUE.items():
        low, high = found.fit.intervals[name]
        assert low < true < high
    assert found.reports["held-out logs"]["mine, tuned"].gain > 0.1
    assert {p.name for p in tmp_path.iterdir()} >= {
        "report.html",
        "results.json",
        "tuned.toml",
        "study.log",
    }


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
    free = study.run(
        ProgramSettings(**options, out=tmp_path / "free"), making.kalman, recordings, contract
    )
    held = study.run(
        ProgramSettings(**options, prior=True, out=tmp_path / "held"),
        making.kalman,
        recordings,
        contract,
    )
    assert free.fit.values["walk_noise"] < held.fit.values["walk_noise"] < 5.0
    with pytest.raises(ValueError, match="--prior needs a likelihood"):
        study.run(
            ProgramSettings(**options, prior=True, measure="one_step", out=tmp_path / "no"),
            making.kalman,
            recordings,
            contract,
        )


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
