"""What is said beside a stream of estimates, and not said again thousands of times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

FIRST = 3  # of a kind that are told one by one; of later ones each that is a power of ten


class Notices:
    """Tells the first of a kind, then the tenth, the hundredth and so on; at the end how many.

    Args:
        tell: where to.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._count: Counter[str] = Counter()

    def __call__(self, kind: str, text: str) -> None:
        """One notice of a kind."""
        self._count[kind] += 1
        n = self._count[kind]
        if n <= FIRST:
            self._tell(text)
        elif set(str(n)[1:]) == {"0"} and str(n)[0] == "1":
            self._tell(f"{text} ({n} times by now)")

    def __enter__(self) -> Notices:
        return self

    def __exit__(self, *_: object) -> None:
        many = [f"{kind} {n} times" for kind, n in self._count.items() if n > FIRST]
        if many:
            self._tell(f"in all: {', '.join(many)}")
