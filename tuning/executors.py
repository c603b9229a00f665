"""Where trials are evaluated: worker processes here, or those of a dask cluster."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import Any

from navgym._checks import positive_int


@contextlib.contextmanager
def workers(count: int, scheduler: str | None = None) -> Iterator[Executor | None]:
    """What evaluates trials.

    Args:
        count: worker processes on this machine; 1: none, trials are evaluated in this one.
        scheduler: address of a dask scheduler, such as "tcp://head:8786", whose workers are used
            instead.

    Raises:
        ValueError: no worker.
        OSError: the scheduler does not answer.
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
    # spawned: a forked worker keeps the parent's ends of its pipes, and would outlive its death
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, context, initializer=_prepare)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _prepare() -> None:
    """A worker leaves Ctrl-C to its parent, which waits for the trials at hand."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@contextlib.contextmanager
def _cluster(scheduler: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ImportError(
            "--scheduler needs dask.distributed: pip install 'navgym[cluster]'."
        ) from error
    try:
        client: Any = Client(scheduler, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError) as error:
        raise OSError(
            f"the dask scheduler at {scheduler} does not answer ({error}): start it with "
            "'dask scheduler', and workers with 'dask worker ADDRESS'."
        ) from error
    with client:
        # pure=False: an evaluation may cost time that is measured, so none is answered from memory
        yield client.get_executor(pure=False)
