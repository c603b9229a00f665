"""What a reader found and did, as sentences."""

from __future__ import annotations

import sys
import time
import warnings


class Notes:
    """Sentences about one file: all are kept, those that make a number doubtful are warnings too.

    Args:
        file: its name, for warnings.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self.sentences: list[str] = []

    def say(self, sentence: str) -> None:
        """Keep what was tidied without harm."""
        self.sentences.append(sentence)

    def doubt(self, sentence: str) -> None:
        """Keep what may make a number wrong, and warn of it."""
        self.sentences.append(sentence)
        warnings.warn(f"{self.file}: {sentence}", UserWarning, stacklevel=5)


class Progress:
    """A line on a terminal's standard error while something takes over two seconds."""

    PATIENCE = 2.0  # s

    def __init__(self, what: str) -> None:
        self.what = what
        self.began = time.monotonic()
        self.shown = False

    def __enter__(self) -> Progress:
        return self

    def at(self, share: float) -> None:
        """Show how much of the work is done, if it has taken long."""
        late = time.monotonic() - self.began > self.PATIENCE
        if late and sys.stderr is not None and sys.stderr.isatty():
            self.shown = True
            sys.stderr.write(f"\r{self.what}: {share:4.0%}")
            sys.stderr.flush()

    def __exit__(self, *_: object) -> None:
        if self.shown:
            sys.stderr.write(f"\r{' ' * (len(self.what) + 6)}\r")
            sys.stderr.flush()
