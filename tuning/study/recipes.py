"""Recordings that travel as recipes: what is sent to a worker is how they were made.

Recordings to tune on weigh megabytes (a deck's, a hundred), and the function and the seeds that made
them a few bytes. So cases made by a `travelling` function are pickled as a call of it, and a worker
process makes them once, however many evaluations it is sent.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ParamSpec, TypeVar

KEPT = 8  # sets of recordings that a process keeps at hand

P = ParamSpec("P")
C = TypeVar("C")


@dataclass(frozen=True)
class Recipe:
    """A call that makes cases: a module-level function and its hashable arguments."""

    make: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: tuple[tuple[str, Any], ...]


def travelling(make: Callable[P, C]) -> Callable[P, C]:
    """Let the cases (a frozen dataclass with a field `recipe`) that `make` returns travel as a call.

    Where an argument cannot be hashed they travel by value.
    """

    @functools.wraps(make)
    def made(*arguments: P.args, **options: P.kwargs) -> C:
        cases: Any = make(*arguments, **options)
        recipe = Recipe(made, arguments, tuple(sorted(options.items())))
        try:
            hash(recipe)
        except TypeError:
            return cases  # type: ignore[no-any-return]
        return replace(cases, recipe=recipe)  # type: ignore[no-any-return]

    return made


@functools.lru_cache(maxsize=KEPT)
def remake(recipe: Recipe) -> Any:
    """The cases of `recipe`, the same object each time while it is among the last few."""
    return recipe.make(*recipe.arguments, **dict(recipe.options))
