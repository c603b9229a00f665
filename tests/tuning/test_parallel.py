"""A study is the same whoever evaluates it, and whatever happens to them."""

import os
import pickle
import signal
import time

import psutil
import pytest

from navgym.tuning.cases import Cases
from navgym.tuning.objectives import Objective
from navgym.tuning.study import executors, search_space
from navgym.tuning.study.executors import workers
from navgym.tuning.study.run import Search, search
from tests.tuning.goals import Bowls, Fatal, Worker, results


@pytest.fixture(scope="module")
def processes():
    with workers(2) as executor:
        yield executor


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed", reason="no dask.distributed")
    made = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    )
    with made:
        yield made


@pytest.fixture(scope="module")
def client(cluster):
    with workers(1, cluster.scheduler_address) as executor:
        yield executor


@pytest.fixture
def quick_models(monkeypatch):
    """Models take over, and generations change, within a few trials."""
    monkeypatch.setattr(search_space, "STARTUP_TRIALS", 4)
    monkeypatch.setattr(search_space, "POPULATION", 4)


def run(goal, trials=20, executor=None, where=None, **more):
    how = Search(trials, **({"batch": 4} | more))
    return search(goal, how, journal=where, progress=False, executor=executor)


# ---- who evaluates


def test_serial_processes_and_a_cluster_find_the_same(processes, client, quick_models):
    cases = Cases.simulated("auv/switch-D", "train", 30, steps=100)
    goal = Objective("qivbf", ("forgetting", "process_noise_scale", "fill"), cases)
    for prune in (False, True):
        alone = run(goal, 20, prune=prune)
        assert any(t.given_up for t in alone.trials) == prune
        assert results(run(goal, 20, processes, prune=prune)) == results(alone)
        assert results(run(goal, 20, client, prune=prune)) == results(alone)


@pytest.mark.parametrize("sampler", ["random", "tpe", "cma-es", "nsga-ii", "gp"])
def test_every_sampler_repeats_itself_alone_and_with_workers(processes, sampler, quick_models):
    trials = 5 if sampler == "gp" else 16
    alone = results(run(Bowls(), trials, sampler=sampler))
    assert results(run(Bowls(), trials, sampler=sampler)) == alone
    assert results(run(Bowls(), trials, processes, sampler=sampler)) == alone


def test_recordings_do_not_travel(processes):
    few, many = (
        Objective("kf", ["process_noise_scale"], Cases.simulated("auv/nominal", "train", n))
        for n in (2, 50)
    )
    assert len(pickle.dumps(many)) < len(pickle.dumps(few)) + 50 * 20


def test_a_clusters_worker_that_dies_is_replaced_and_one_that_always_dies_is_told(
    cluster, client, tmp_path, monkeypatch
):
    goal = Bowls()
    fatal = Fatal(goal, once=str(tmp_path / "killed"))
    assert results(run(fatal, 8, client)) == results(run(goal, 8))
    assert (tmp_path / "killed").exists()
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)
    with (
        pytest.raises(OSError, match=r"lost its workers.*same command again"),
        workers(1, cluster.scheduler_address) as executor,
    ):
        run(Fatal(goal), 4, executor)


def test_a_worker_process_that_dies_is_told_and_costs_no_finished_trial(tmp_path):
    journal, goal = tmp_path / "study.log", Bowls()
    first = results(run(goal, 4, where=journal))
    with (
        pytest.raises(OSError, match=r"a worker process died.*same command again"),
        workers(2) as executor,
    ):
        run(Fatal(goal), 12, executor, journal)
    assert results(run(goal, 12, where=journal))[:4] == first
    assert results(run(goal, 12, where=journal)) == results(run(goal, 12))


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr(executors, "PATIENCE", 1)
    with (
        pytest.raises(OSError, match=r"tcp://127.0.0.1:9 does not answer .*dask scheduler"),
        workers(1, "tcp://127.0.0.1:9"),
    ):
        pass


def test_no_workers_are_refused():
    with (
        pytest.raises(ValueError, match="workers must be a whole number of at least 1, got 0"),
        workers(0),
    ):
        pass


# ---- what stops them


def pids(marks):
    return [int(line) for line in marks.read_text().split()] if marks.exists() else []


def wait_for(condition):
    for _ in range(1200):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("waited in vain")


def alive(pid):
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize(("how", "prune"), [(signal.SIGINT, False), (signal.SIGKILL, True)])
def test_a_study_stopped_in_the_middle_of_a_batch_ends_like_one_that_was_not(tmp_path, how, prune):
    journal, marks = tmp_path / "study.log", tmp_path / "marks"
    options = ["--workers", 2, "--batch", 4, "--trials", 24, "--marks", marks, "--pause", 0.05]
    other = Worker(tmp_path / "said", journal, *options, *(["--prune"] if prune else []))
    wait_for(lambda: len(pids(marks)) >= 14)  # in the fourth batch, or in a race of the third
    if how == signal.SIGINT:
        os.killpg(other.pid, how)  # as a terminal does: to the workers as well
    else:
        os.kill(other.pid, how)
    status, said = other.wait()
    assert "Traceback" not in said
    if how == signal.SIGINT:
        assert status == 130
        assert "stopping after this trial" in said
    wait_for(lambda: not any(map(alive, pids(marks))))
    begun = run(Bowls(), 1, where=journal, prune=prune)
    assert 4 <= len(begun.trials) < 24
    whole = results(run(Bowls(), 24, prune=prune))
    assert results(begun) == whole[: len(begun.trials)]
    assert results(run(Bowls(), 24, where=journal, prune=prune)) == whole


def test_ctrl_c_while_workers_are_starting_ends_cleanly(tmp_path):
    marks = tmp_path / "marks"
    journal = tmp_path / "study.log"
    options = ["--workers", 2, "--batch", 4, "--trials", 24, "--marks", marks]
    other = Worker(tmp_path / "said", journal, *options)
    wait_for(lambda: journal.exists() and b'"state":0' in journal.read_bytes())  # asked for
    assert not pids(marks)
    os.killpg(other.pid, signal.SIGINT)
    status, said = other.wait()
    assert (status, said.count("\n")) == (130, 1)
    assert len(run(Bowls(), 1, where=journal).trials) == 4
