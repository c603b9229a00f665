"""Where studies live: a journal file (one process at a time), or a database (many machines)."""

from __future__ import annotations

import contextlib
import copy
import importlib.util
import json
import os
import re
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.storages import BaseStorage, InMemoryStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

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
    except Exception:  # no URL, but it may hold a password all the same
        return re.sub(r"://.*@", "://***@", str(where))


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
        storage = _database(str(where), heartbeat, grace)
        try:
            yield storage
        finally:
            storage.engine.dispose()
    else:
        journal = Path(where)
        with _alone(journal):
            yield _journal(journal)


# ---- databases


def _database(url: str, heartbeat: int, grace: int) -> RDBStorage:
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError, SQLAlchemyError

    try:
        make_url(url)
    except (ArgumentError, ValueError) as error:  # the latter for a port that is no number
        raise ValueError(
            f"storage {shown(url)!r} is no database URL: write it like postgresql://user@host/name."
        ) from error
    try:
        return _connected(_with_driver(url), heartbeat, grace)
    except ImportError as error:
        raise ValueError(
            f"storage {shown(url)} needs a driver that is not installed ({error}): for PostgreSQL "
            "pip install 'psycopg[binary]'."
        ) from error
    except ArgumentError as error:
        raise ValueError(f"storage {shown(url)!r} is of an unknown kind: {error}.") from error
    except SQLAlchemyError as error:
        raise unreachable(url, error) from error


def _connected(url: str, heartbeat: int, grace: int) -> RDBStorage:
    """Optuna's storage, its tables made if they are missing."""
    from sqlalchemy.exc import IntegrityError, OperationalError, ProgrammingError

    def connect() -> RDBStorage:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            return RDBStorage(
                url,
                engine_kwargs={"pool_pre_ping": True},  # a server may have been restarted
                heartbeat_interval=heartbeat,
                grace_period=grace,
                heartbeat_stale_trial_callback=retry(),
            )

    try:
        return connect()
    except (IntegrityError, OperationalError, ProgrammingError) as error:
        if "already exists" not in str(error):
            raise
        time.sleep(1.0)  # another worker was making the tables at the same moment
        return connect()


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


def retry() -> Callable[[optuna.Study, FrozenTrial], None]:
    """What puts the parameters of a dead worker's trial back in line, a few times at most."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        enqueue = optuna.storages.RetryHeartbeatStaleTrialCallback(max_retry=RETRIES)

    def again(study: optuna.Study, trial: FrozenTrial) -> None:
        fresh = copy.deepcopy(trial)
        fresh.user_attrs = {}  # who worked on it, and half of what was found, are the dead one's
        enqueue(study, fresh)

    return again


def try_again(study: optuna.Study, trial: FrozenTrial) -> None:
    """Fail a running trial and put its parameters back in line, unless others have done so."""
    with contextlib.suppress(UpdateFinishedTrialError):
        study._storage.set_trial_state_values(trial._trial_id, TrialState.FAIL)
        retry()(study, trial)


def put_back(study: optuna.Study, trial: FrozenTrial, names: Sequence[str]) -> None:
    """Let a study that nobody else works on continue as if a running trial had not begun.

    The trial keeps its number and its place in line, so that the study goes on like one that was never
    stopped. If it was cut short before all its parameters (`names`) were drawn it is dropped: the next
    one is drawn in its place, in the same way.
    """
    whole = "fixed_params" in trial.system_attrs or set(names) <= trial.params.keys()
    state = TrialState.WAITING if whole else TrialState.FAIL
    study._storage.set_trial_state_values(trial._trial_id, state)


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


class _Lines(JournalFileBackend):
    """Optuna's journal file for the process that holds it: entries are written whole or not at all.

    Optuna waits for the disk at each entry, some ten per trial. Here only `settle` does, once a batch
    of trials is told: a kill loses nothing that was written, and a power cut the batch at hand.
    """

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Write entries at the end; OSError if the disk is full or the file is gone."""
        text = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs)
        with self._named_errors():
            self._lock.acquire()  # a dashboard may write its notes
            try:
                self._append(text.encode())
            finally:
                self._lock.release()

    def settle(self) -> None:
        """Wait until the disk has all that was written; OSError where it cannot."""
        with self._named_errors(), Path(self._file_path).open("r+b") as file:
            os.fsync(file.fileno())

    @contextlib.contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OSError(
                f"{self._file_path} cannot be written ({error.strerror}): make room, and give the "
                "same command again. Finished trials are safe."
            ) from error

    def _append(self, text: bytes) -> None:
        journal = Path(self._file_path)
        size = journal.stat().st_size
        try:
            with journal.open("ab") as file:
                file.write(text)
        except OSError:
            os.truncate(journal, size)  # half an entry would spoil the next one
            raise


def settle(storage: BaseStorage) -> None:
    """Have finished trials outlast a power cut; a database sees to it itself."""
    if isinstance(storage, JournalStorage) and isinstance(storage._backend, _Lines):
        storage._backend.settle()


def _journal(journal: Path) -> JournalStorage:
    """The journal file as Optuna's storage, its damaged last line cut off.

    Raises ValueError, naming the line, for a file that is damaged elsewhere or no journal.
    """
    _check(journal)
    try:
        # absolute: Optuna's lock is a link that is resolved from its own folder
        return JournalStorage(_Lines(str(journal.resolve())))
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
        except (ValueError, RecursionError):
            entry = None
        if not isinstance(entry, dict) or "op_code" not in entry:
            raise ValueError(
                f"{journal} is damaged at line {number}: {line[:60]!r} is no journal entry. "
                "Move the file away to start anew, or cut it off before that line to keep the rest."
            )
    if whole < len(content):
        os.truncate(journal, whole)
