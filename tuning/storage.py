"""Where studies live: a journal file (one process at a time), or a database (many machines)."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import BaseStorage, InMemoryStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend

Where = Path | str | None

RETRIES = 3  # of a trial whose worker died, before it is given up
# s: how often a worker says that it lives, and how long its silence means that it does not
HEARTBEAT, GRACE = 10, 60


def is_url(where: Where) -> bool:
    """Whether `where` names a database, and not a file."""
    return isinstance(where, str) and "://" in where


def shown(where: Where) -> str:
    """`where` as it may be printed: without a password."""
    if not is_url(where):
        return "memory" if where is None else str(where)
    from sqlalchemy.engine import make_url

    try:
        return make_url(str(where)).render_as_string(hide_password=True)
    except Exception:
        return str(where)


@contextlib.contextmanager
def opened(where: Where, heartbeat: int = HEARTBEAT, grace: int = GRACE) -> Iterator[BaseStorage]:
    """The storage at `where`: None for memory, a path for a journal, an SQLAlchemy URL for a database.

    A journal is this process's alone while it is open. What a kill or a full disk cut short at its end
    is dropped.

    Args:
        where: see above.
        heartbeat: s between a database worker's signs of life.
        grace: s of silence after which its trials are tried again by others.

    Raises:
        ValueError: a damaged journal, a file that is none, a URL that no driver serves.
        OSError: a journal that cannot be written or is in use; a database that cannot be reached.
    """
    if where is None:
        yield InMemoryStorage()
    elif is_url(where):
        yield _database(str(where), heartbeat, grace)
    else:
        journal = Path(where)
        with _alone(journal):
            yield _journal(journal)


# ---- databases


def _database(url: str, heartbeat: int, grace: int) -> RDBStorage:
    from sqlalchemy.exc import ArgumentError, SQLAlchemyError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            return RDBStorage(
                _with_driver(url),
                engine_kwargs={"pool_pre_ping": True},  # a server may have been restarted
                heartbeat_interval=heartbeat,
                grace_period=grace,
                heartbeat_stale_trial_callback=retry(),
            )
    except ImportError as error:
        raise ValueError(
            f"storage {shown(url)} needs a driver that is not installed ({error}): for PostgreSQL "
            "pip install 'psycopg[binary]'."
        ) from error
    except ArgumentError as error:
        raise ValueError(f"storage {shown(url)!r} is no database URL: {error}.") from error
    except SQLAlchemyError as error:
        raise unreachable(url, error) from error


def unreachable(where: Where, error: BaseException) -> OSError:
    """A database's error as one that says what to do."""
    reason = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
    return OSError(
        f"storage {shown(where)} cannot be used: {reason}. Check that the server runs, that user, "
        "password and database are right, and that the user may write. Finished trials are safe."
    )


def _with_driver(url: str) -> str:
    """A plain PostgreSQL URL by the driver that is installed: psycopg 3 rather than psycopg2."""
    scheme, rest = url.split("://", 1)
    modern = importlib.util.find_spec("psycopg") is not None
    if scheme in {"postgresql", "postgres"} and modern:
        return f"postgresql+psycopg://{rest}"
    return url


def retry() -> Any:
    """What puts the trial of a dead worker back in line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.storages.RetryHeartbeatStaleTrialCallback(max_retry=RETRIES)


def record_life(storage: BaseStorage, trial_id: int) -> None:
    """Let the database know that someone works on a trial."""
    if isinstance(storage, RDBStorage):
        storage.record_heartbeat(trial_id)


@contextlib.contextmanager
def signs_of_life(storage: BaseStorage, trial_ids: Sequence[int], every: float) -> Iterator[None]:
    """Record life of some trials each `every` seconds, from a thread."""
    over = threading.Event()

    def beat() -> None:
        while not over.wait(every):
            for trial_id in trial_ids:
                with contextlib.suppress(Exception):  # a server away for a moment
                    record_life(storage, trial_id)

    if not isinstance(storage, RDBStorage):
        yield
        return
    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


# ---- journal files


@contextlib.contextmanager
def _alone(journal: Path) -> Iterator[None]:
    """Hold the journal for this process; the lock goes with the process, however it ends."""
    try:
        journal.parent.mkdir(parents=True, exist_ok=True)
        file = journal.open("ab")
    except OSError as error:
        raise OSError(
            f"{journal} cannot be written ({error.strerror}): name another file or folder."
        ) from error
    with file:
        try:
            import fcntl
        except ImportError:  # no such lock on this system: then the user must see to it
            yield
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OSError(
                f"{journal} is in use by another process. Wait for it, name another folder, or use "
                "a database (--storage postgresql://…) that many processes can share."
            ) from None
        # Optuna's own lock, left by a process that was killed while writing: nobody else is here
        Path(f"{journal.resolve()}.lock").unlink(missing_ok=True)
        yield


def _journal(journal: Path) -> JournalStorage:
    """The journal file as Optuna's storage, its damaged last line cut off.

    Raises ValueError, naming the line, for a file that is damaged elsewhere or no journal.
    """
    _check(journal)
    try:
        # absolute: Optuna's lock is a link that is resolved from its own folder
        return JournalStorage(JournalFileBackend(str(journal.resolve())))
    except (ValueError, KeyError, TypeError, AssertionError, AttributeError) as error:
        raise ValueError(
            f"{journal} is no Optuna journal ({type(error).__name__}: {error}): name another file."
        ) from error


def _check(journal: Path) -> None:
    """Drop a last line that a kill or a full disk cut short; ValueError for other damage."""
    content = journal.read_bytes()
    whole = content.rfind(b"\n") + 1
    for number, line in enumerate(content[:whole].splitlines(), start=1):
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if not isinstance(entry, dict) or "op_code" not in entry:
            raise ValueError(
                f"{journal} is damaged at line {number}: {line[:60]!r} is no journal entry. "
                "Move the file away to start anew, or cut it off before that line to keep the rest."
            )
    if whole < len(content):
        os.truncate(journal, whole)
