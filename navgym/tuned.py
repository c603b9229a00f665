"""Parameters found by a study, as a file: `navgym.estimate(name, recording, "tuned.toml")`.

The file is TOML: `filter`, a table `[parameters]`, and a table `[provenance]` that says what they rest
on. It can be written by hand.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from navgym.core.storage import read_toml
from navgym.problem import problems_with


@dataclass(frozen=True)
class Tuned:
    """Parameters of one filter, and where they come from.

    Args:
        filter: a name of `navgym.filters()`.
        parameters: as `navgym.estimate` takes them; what is missing stays at its default.
        provenance: the study: command, seeds, versions, what was gained.
    """

    filter: str
    parameters: Mapping[str, Any]
    provenance: Mapping[str, Any] = field(default_factory=dict)


def read_tuned(path: str | os.PathLike[str]) -> Tuned:
    """Read and check a file of tuned parameters.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: no TOML, no filter, or parameters that the filter does not have or that lie
            outside their ranges; the message names the file.
    """
    content = read_toml(path)
    missing = [name for name in ("filter", "parameters") if name not in content]
    if missing or not isinstance(content.get("parameters"), dict):
        raise ValueError(
            f"{path} holds no tuned parameters: it lacks {(missing or ['[parameters]'])[0]!r}."
        )
    try:
        _check(content["filter"], content["parameters"])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return Tuned(content["filter"], content["parameters"], content.get("provenance", {}))


def _check(filter_name: Any, parameters: Mapping[str, Any]) -> None:
    """ValueError unless some problem's filter of that name takes the parameters."""
    wrong = None
    for problem in problems_with(filter_name):
        try:
            problem.filters[filter_name].space.array(parameters)
        except ValueError as error:
            wrong = wrong or error
        else:
            return
    if wrong is not None:
        raise wrong


def settled(parameters: Any, filter_name: str) -> Any:
    """`parameters` themselves, or, if they are the path of a file, those it holds for the filter.

    Raises ValueError if the file is of another filter.
    """
    if not isinstance(parameters, (str, os.PathLike)):
        return parameters
    found = read_tuned(parameters)
    if found.filter != filter_name:
        raise ValueError(
            f"{os.fspath(parameters)} holds parameters of {found.filter!r}, not of {filter_name!r}: run "
            "that filter, or tune this one."
        )
    return dict(found.parameters)
