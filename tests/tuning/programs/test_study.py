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

from navgym.tuning.declared import from_toml
from navgym.tuning.programs import command, report, study
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.function import tune
from navgym.tuning.programs.settings import ProgramSettings
from navgym.tuning.report import study as usual
from tests import commands
from tests.browser import check, needs_browser
from tests.tuning.programs import making
from tests.tuning.programs.test_runner import gone

TRIALS = 12
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


@pytest.fixture(scope="module")
def done(walk, tmp_path_factory):
    out = tmp_path_factory.mktemp("done")
    code, text, err = run(walk, *words(walk, "--trials", TRIALS, "--out", out, count=4))
    assert code == 0, err
    return out, text


SMALL = ("--trials", 8, "--free", "process", "--repeats", 1)


def small(walk, out, **more):
    """A study of one parameter with `SMALL`; what comes of it, but for machines and clocks."""
    with contextlib.chdir(walk):
        settings = ProgramSettings(
            program="./walk {parameters} {log} {out}", parameters=walk / "walk.toml", free=("process",),
            log=tuple(walk / f"log{i}.csv" for i in range(3)), trials=8, repeats=1, out=out,
            **{"workers": 1} | more,
        )  # fmt: skip
        found = usual.results(study.run(settings), {})
    return {
        n: v
        for n, v in found.items()
        if n not in ("provenance", "settings", "microseconds per filter step")
    }


@pytest.fixture(scope="module")
def once(walk, tmp_path_factory):
    out = tmp_path_factory.mktemp("once")
    return out, small(walk, out)


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
    split = (
        "tuned on log0.csv, log1.csv; chosen among the leaders on log2.csv; reported on log3.csv"
    )
    assert split in text
    assert split.partition(";")[0] in (out / "report.html").read_text()
    about = json.loads((out / "results.json").read_text())["reports"]["held-out logs"][
        "recordings"
    ]["logs"]
    assert [each.split()[0] for each in about] == ["log3.csv"]


def test_a_deterministic_program_is_said_to_be_one(done):
    assert "deterministic: 3 runs of the defaults agree in every digit" in done[1]


def test_the_same_study_again_runs_the_program_not_once(once, walk):
    out, found = once
    kept = {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*.json")}
    assert small(walk, out) == found
    assert {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*.json")} == kept


@pytest.mark.slow
def test_two_workers_find_the_same(once, walk, tmp_path):
    assert small(walk, tmp_path, workers=2) == once[1]


def test_a_cluster_finds_the_same(once, walk, tmp_path):
    """In threads of this process: dask's processes are those of tests/tuning/test_parallel."""
    distributed = pytest.importorskip("distributed", reason="no dask.distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        assert small(walk, tmp_path, scheduler=cluster.scheduler_address) == once[1]


def test_the_written_settings_are_those_that_were_asked_for(done, walk):
    with contextlib.chdir(walk):
        read = from_toml(ProgramSettings, done[0] / "settings.toml")
    assert (read.trials, read.workers, len(read.log)) == (TRIALS, 1, 4)
    assert read.program == "./walk {parameters} {log} {out}"


def unnumbered(found):
    """What was found, without the numbers of trials."""
    if isinstance(found, dict):
        return {k: unnumbered(v) for k, v in found.items() if k != "number"}
    return [unnumbered(each) for each in found] if isinstance(found, list) else found


def test_killed_and_given_again_it_ends_like_one_that_was_not(once, walk, tmp_path):
    command = [sys.executable, "-m", "navgym.command"]
    process = commands.started(
        [*command, *map(str, words(walk, *SMALL, "--out", tmp_path, count=3))], walk
    )
    journal, until = tmp_path / "study.log", time.monotonic() + 60
    while time.monotonic() < until and process.poll() is None:
        if journal.exists() and journal.read_text().count('"state":1') >= 4:
            break
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (tmp_path / "results.json").exists()
    assert gone(str(walk / "walk"))
    # the trial that was under way when it was killed leaves a number behind, and nothing else
    assert unnumbered(small(walk, tmp_path)) == unnumbered(once[1])


def quick(walk, fault, out, count=3, **more):
    """A small study of the program with a fault, and what its report says of the program."""
    options = {"trials": 4, "repeats": 2, "workers": 1, "out": out} | more
    found = study.run(
        ProgramSettings(
            program=f"{walk / 'walk'} {{parameters}} {{log}} {{out}} {fault}", parameters=walk / "walk.toml",
            log=tuple(walk / f"log{i}.csv" for i in range(count)), **options,
        )
    )  # fmt: skip
    return found, "\n".join(report.said(found))


def test_runs_that_fail_are_counted_shown_and_never_fatal(walk, tmp_path):
    found, said = quick(walk, "fails", tmp_path, time_limit=1.0, prune=False, trials=16)
    assert "runs of the trials failed" in said
    assert "the filter lost its track" in found.examples["exit status 1"]
    assert {"exit status 1", "garbage", "time-out"} <= set(found.failures)
    told = "; ".join(line for t in found.outcome.trials for line in t.failed)
    assert told.count("the filter lost its track") == found.failures["exit status 1"]
    assert all(np.isfinite(t.result) for t in found.outcome.trials)
    assert "the filter lost its track" in str(report._program(found))


def test_a_parameter_that_the_program_ignores_is_named(walk, tmp_path):
    found, said = quick(walk, "ignores", tmp_path)
    assert "The program ignores meter_noise" in said
    assert report.ignored(found) == ["meter_noise"]


def test_a_program_that_says_something_else_each_time_is_measured(walk, tmp_path):
    found, said = quick(walk, "chance", tmp_path)
    assert "The program is not deterministic: over 2 runs" in said
    assert "cannot be told from chance" in said
    assert found.twice.seen > 0.0


def test_a_filter_that_drops_what_it_does_not_like_does_not_win(walk, tmp_path):
    found, said = quick(walk, "drops", tmp_path, trials=8, range={"walk_noise": (0.5, 20.0)})
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
    path = script(f"walk={walk / 'walk'}\n{text}")
    logs = tuple(walk / f"log{i}.csv" for i in range(3))
    asked = ProgramSettings(
        program=f"{path} {{parameters}} {{log}} {{out}}", parameters=walk / "walk.toml", log=logs,
        workers=1, out=tmp_path,
    )  # fmt: skip
    with pytest.raises(ValueError, match=message):
        study.run(asked)


def test_a_log_on_which_the_defaults_fail_is_left_out_and_named(walk, tmp_path):
    _, said = quick(walk, "damaged", tmp_path, count=4, free=("process",))
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


def test_one_log_is_cut_in_time_and_it_is_said(walk, tmp_path):
    found, _ = quick(walk, "", tmp_path, count=1, free=("process",))
    assert "each log is cut in time: tuned on the first 50%" in found.stages.split
    assert "judge better" in found.stages.split
    assert found.winner["meter_noise"] == 0.5
    assert [p[0].span for p in (found.stages.train["logs"], found.stages.report["logs"])] == [
        (0, 120),
        (168, 240),
    ]


# ---- functions


def tuned(out, call, recordings, **more):
    options = {"trials": 8, "repeats": 2, "workers": 1, "out": out, "name": "mine"} | more
    return study.run(ProgramSettings(**options), call, recordings, Contract.of_dict(NOISES))


def three(first, **more):
    made = [making.series(first + i, **more) for i in range(4)]
    return {"log": made[:2], "select_log": made[2:3], "report_log": made[3:]}


def test_a_function_is_tuned_like_a_program(tmp_path):
    found = tuned(tmp_path, making.kalman, three(10))
    for name, true in making.TRUE.items():
        low, high = found.fit.intervals[name]
        assert low < true < high
    assert found.reports["held-out logs"]["mine, tuned"].gain > 0.1


@pytest.mark.slow  # as the one above, with a page
def test_a_function_leaves_what_a_program_leaves(tmp_path):
    logs = three(10)
    found = tune(
        making.kalman, logs.pop("log"), NOISES["parameters"], **logs, trials=8, workers=1, out=tmp_path
    )  # fmt: skip
    assert found.settings.filter == "kalman"
    for name in ("report.html", "results.json", "tuned.toml", "study.log"):
        assert (tmp_path / name).exists()


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
    options = {"trials": 8, "repeats": 1, "workers": 1}
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
    found = tuned(tmp_path, smoother, recordings, free=("walk_noise",), trials=16)
    report_ = found.reports["held-out logs"]
    assert found.measure.name == "rmse"
    assert report_["mine, tuned"].mean < report_["mine, default"].mean
