"""Parameters found by a study, as a file: `navgym.estimate(name, recording, "tuned.toml")`.

The file is TOML: `filter`, a table `[parameters]`, a table `[model]` with the noise that the recordings'
model believed, which the scales among the parameters refer to, and a table `[provenance]` that says
what they rest on. It can be written by hand; without `[model]` the scales are taken at their word.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from navgym.core.storage import read_toml
from navgym.problem import Believed, problems_with

SCALES = ("_noise_scale", "_process_scale")  # how scales of a model's sensors and axes end


@dataclass(frozen=True)
class Tuned:
    """Parameters of one filter, and where they come from.

    Args:
        filter: a name of `navgym.filters()`.
        parameters: as `navgym.estimate` takes them; what is missing stays at its default.
        provenance: the study: command, seeds, versions, what was gained.
        model: what the recordings' model believed of noise, by name: standard deviations, or root
            densities, one per row or axis.
    """

    filter: str
    parameters: Mapping[str, Any]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    model: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def doubts(self, believed: Mapping[str, Believed]) -> list[str]:
        """Where a recording's model believes in other noise than the file's did, and how to convert.

        Args:
            believed: what the recording's model believes, from `Problem.noises`.
        """
        said = []
        for name, own in self.model.items():
            here = believed.get(name)
            if here is None:
                said.append(f"{name} was {_shown(own)}, and this recording has none")
            elif not _alike(own, here.deviations):
                said.append(_conversion(name, own, here, self.parameters))
        return said


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
        model = _numbers(content.get("model", {}))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return Tuned(content["filter"], content["parameters"], content.get("provenance", {}), model)


def _numbers(model: Any) -> dict[str, tuple[float, ...]]:
    """The table `[model]`, a number or a list of them by name."""
    found = {}
    for name, value in model.items() if isinstance(model, Mapping) else [("model", model)]:
        try:
            each = tuple(float(v) for v in (value if isinstance(value, list) else [value]))
        except (TypeError, ValueError):
            each = ()
        if not each or not all(0.0 <= v < math.inf for v in each):
            raise ValueError(f"model.{name} must hold numbers of at least 0, got {value!r}.")
        found[name] = each
    return found


def as_model(believed: Mapping[str, Believed]) -> dict[str, Any]:
    """What a model believes of noise, as the table `[model]`: one number where all are alike."""
    return {
        name: b.deviations[0] if len(set(b.deviations)) == 1 else list(b.deviations)
        for name, b in believed.items()
    }


def _shown(deviations: tuple[float, ...]) -> str:
    return ", ".join(f"{v:.4g}" for v in dict.fromkeys(deviations))


def _alike(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Whether noises differ by no more than one would notice."""
    pairs = _pairs(one, other)
    return all(math.isclose(a, b, rel_tol=0.01) for a, b in pairs) and bool(pairs)


def _pairs(one: tuple[float, ...], other: tuple[float, ...]) -> list[tuple[float, float]]:
    """Noises beside each other; one number stands for all."""
    most = max(len(one), len(other))
    longer = [x * most if len(x) == 1 else x for x in (one, other)]
    return list(zip(*longer, strict=False)) if len(longer[0]) == len(longer[1]) else []


def _conversion(
    name: str, own: tuple[float, ...], here: Believed, parameters: Mapping[str, Any]
) -> str:
    text = f"{name} was {_shown(own)} and is {_shown(here.deviations)} here"
    factors = [(a / b) ** 2 for a, b in _pairs(own, here.deviations) if b > 0.0]
    if not factors or max(factors) > 1.02 * min(factors):
        return text
    factor = math.prod(factors) ** (1.0 / len(factors))
    scale = parameters.get(here.scale, 1.0)
    if not isinstance(scale, (int, float)):
        return text
    return f"{text}: for the same noise {here.scale} = {scale:.4g} x {factor:.4g} = {scale * factor:.4g}"


def _check(filter_name: Any, parameters: Mapping[str, Any]) -> None:
    """ValueError unless some problem's filter of that name takes the parameters.

    Scales of sensors and axes belong to a recording's model: only that they are positive is checked.
    """
    wrong = None
    for problem in problems_with(filter_name):
        space = problem.filters[filter_name].space
        own = {n: v for n, v in parameters.items() if n in space.names or not n.endswith(SCALES)}
        try:
            space.array(own)
            for name in parameters.keys() - own.keys():
                _positive(name, parameters[name])
        except ValueError as error:
            wrong = wrong or error
        else:
            return
    if wrong is not None:
        raise wrong


def _positive(name: str, value: Any) -> None:
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not known or not 0.0 < value < math.inf:
        raise ValueError(f"{name} must be a positive number, got {value!r}.")


def settled(
    parameters: Any, filter_name: str, believed: Callable[[], Mapping[str, Believed]] | None = None
) -> Any:
    """`parameters` themselves, or, if they are the path of a file, those it holds for the filter.

    Warns (UserWarning) where the file's scales refer to other noise than the recording's model believes.

    Args:
        parameters: anything that `navgym.estimate` takes.
        filter_name: the filter's.
        believed: () to what the recording's model believes, from `Problem.noises`.

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
    doubts = found.doubts(believed()) if believed is not None and found.model else []
    if doubts:
        warnings.warn(
            f"{os.fspath(parameters)} was tuned on a model that believed in other noise, and its scales "
            f"multiply this one's: {'; '.join(doubts)}. Read the recording as the tuned ones were, or "
            "convert the scales.",
            stacklevel=3,
        )
    return dict(found.parameters)
