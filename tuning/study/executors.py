"""Where trials are evaluated: worker processes here, or those of a dask cluster."""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
from multiprocessing.connection import Connection
from typing import Any

from navgym.core.checks import positive_int
from navgym.problem import REGISTERED, Registered, adopt

THREADS = "OMP_NUM_THREADS"
PATIENCE = 10  # s for a scheduler to answer


@contextlib.contextmanager
def workers(count: int, scheduler: str | None = None) -> Iterator[Executor | None]:
    """What evaluates trials.

    Args:
        count: worker processes on this machine; 1: none, trials are evaluated in this one.
        scheduler: address of a dask scheduler, such as "tcp://head:8786", whose workers are used
            instead.

    Raises:
        ValueError: no worker.
        OSError: the scheduler does not answer; workers died.
        ImportError: a scheduler without dask.distributed.
    """
    positive_int("workers", count)
    if scheduler is not None:
        with _cluster(scheduler) as executor:
            yield executor
    elif count == 1:
        yield None
    else:
        with _processes(count) as executor:
            yield executor


@contextlib.contextmanager
def _processes(count: int) -> Iterator[Executor]:
    # spawned: kernels' threads and database connections do not survive a fork
    context = multiprocessing.get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(count, context, _prepare, (theirs, dict(REGISTERED)))
    with _held_interrupts(), _one_thread():
        for _ in range(count):  # each submission starts a process
            pool.submit(os.getpid)
    try:
        yield pool
        pool.shutdown()
    except BrokenExecutor as error:
        raise OSError(
            "a worker process died, killed or out of memory: give the same command again, with "
            "fewer --workers if memory was short. Finished trials are safe."
        ) from error
    finally:
        ours.close()  # whoever is still at work ends at once
        pool.shutdown(cancel_futures=True)
        theirs.close()


@contextlib.contextmanager
def _held_interrupts() -> Iterator[None]:
    """Ctrl-C comes after the block; processes that are started in it do not see any (`_prepare`)."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes that are started in the block give linear algebra one thread each."""
    given = os.environ.get(THREADS)
    os.environ.setdefault(THREADS, "1")
    try:
        yield
    finally:
        if given is None:
            del os.environ[THREADS]


def _prepare(lifeline: Connection, registered: Mapping[str, Registered]) -> None:
    """A worker leaves Ctrl-C to its parent, which waits for the trials at hand, and dies with it.

    It knows the problems that its parent knows.
    """
    adopt(registered)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, args=(lifeline,), daemon=True).start()


def _follow(lifeline: Connection) -> None:
    """End this process when the parent's end of the pipe closes, by its death if not before.

    The pool's own queue would stay open: every worker holds an end of it.
    """
    lifeline.poll(None)
    os._exit(1)


@contextlib.contextmanager
def _cluster(scheduler: str) -> Iterator[Executor]:
    try:
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise ImportError(
            "--scheduler needs dask.distributed: pip install 'navgym[cluster]'."
        ) from error
    try:
        client: Any = Client(scheduler, timeout=PATIENCE)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError) as error:
        raise OSError(
            f"the dask scheduler at {scheduler} does not answer ({error}): start it with "
            "'dask scheduler', and workers with 'dask worker ADDRESS'."
        ) from error
    with client:
        # workers of today and tomorrow know the problems that this process knows
        client.register_worker_callbacks(functools.partial(adopt, dict(REGISTERED)))
        # pure=False: an evaluation may cost time that is measured, so none is answered from memory
        try:
            yield client.get_executor(pure=False)
        except (KilledWorker, CancelledError) as error:
            raise OSError(
                f"the cluster at {scheduler} lost its workers or its scheduler "
                f"({str(error) or type(error).__name__}): see what "
                "they say, and give the same command again. Finished trials are safe."
            ) from error
