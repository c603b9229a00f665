"""navgym tune as a user runs it: stopped, resumed, repeated, on one core and on two."""

import functools
import json
import signal
import time

import pytest

from tests import commands

SMALL = (
    "--filter", "kf", "--scenario", "auv/mismatch", "--steps", "100", "--runs", "6", "--select-runs", "6",
    "--report-runs", "8",
)  # fmt: skip


start, run = functools.partial(commands.start, "tune"), functools.partial(commands.run, "tune")


def results(folder):
    found = json.loads((folder / "results.json").read_text())
    for machine in ("provenance", "settings", "microseconds per filter step"):
        found.pop(machine)
    return found


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    folder = tmp_path_factory.mktemp("serial")
    code, out, err = run(*SMALL, "--trials", 14, "--workers", 1, "--out", folder)
    assert code == 0, err
    return folder, out


def test_it_ends_with_the_table_the_gain_and_where_everything_is(serial):
    folder, out = serial
    assert "kf, tuned" in out
    assert "gain of tuned over default: auv/mismatch: +" in out
    assert f"written to {folder}: report.html, results.json, tuned.toml" in out
    assert {p.name for p in folder.iterdir()} == {
        "report.html", "results.json", "settings.toml", "study.log", "tuned.toml",
    }  # fmt: skip


def test_two_workers_find_what_one_finds(serial, tmp_path):
    code, _, err = run(*SMALL, "--trials", 14, "--workers", 2, "--out", tmp_path)
    assert code == 0, err
    assert results(tmp_path) == results(serial[0])


def test_the_written_settings_ask_for_the_same_again(serial, tmp_path):
    folder, _ = serial
    code, _, err = run("--config", folder / "settings.toml", "--out", tmp_path)
    assert code == 0, err
    assert results(tmp_path) == results(folder)


def test_stopped_by_ctrl_c_it_goes_on_where_it_was(tmp_path):
    long = (*SMALL, "--trials", 3000, "--workers", 1, "--out", tmp_path)
    process = start(*long)
    journal = tmp_path / "study.log"
    deadline = time.monotonic() + 90
    while time.monotonic() < deadline and process.poll() is None:
        if journal.exists() and journal.read_text().count('"state":1') >= 6:  # told
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "the same command goes on from there" in out
    done = int(out.split("stopped after ")[1].split()[0])
    assert done >= 6
    # the number of trials is no part of what a study is for, so it can be raised or lowered
    code, out, err = run(*SMALL, "--trials", done, "--workers", 1, "--out", tmp_path)
    assert code == 0, err
    assert len(results(tmp_path)["trials"]) == done


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--filter", "qivf"), "Did you mean 'qivbf'"),
        (("--trials", 0), "trials must be a whole number of at least 1"),
        (("--range", "process_noise_scale", 5, 5), "must be low < high"),
        (("--log", "nowhere.csv"), "no log at nowhere.csv"),
        (("--storage", "postgresql://nobody:secret@127.0.0.1:1/none"), "cannot be used"),
        (("--out", "/proc/nothing"), "/proc/nothing"),
    ],
)
def test_what_cannot_be_done_is_said_at_once(arguments, message, tmp_path):
    code, _, err = run(*SMALL, "--out", tmp_path, *arguments)
    assert code == 2
    assert message in " ".join(err.replace("│", " ").split())
    assert "secret" not in err
    assert "Traceback" not in err


def test_another_question_in_the_same_folder_is_refused(serial):
    folder, _ = serial
    code, _, err = run(*SMALL, "--trials", 14, "--workers", 1, "--seed", 1, "--out", folder)
    assert code == 2
    assert "belongs to another search" in err
