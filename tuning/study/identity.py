"""Whose study it is: a study remembers its goal, and refuses another."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import optuna
from optuna.storages import BaseStorage
from optuna.trial import TrialState

from navgym.core.parameters import ParameterSpace
from navgym.tuning.objectives import Goal
from navgym.tuning.study.search_space import to_optuna
from navgym.tuning.study.storage import Where, is_url, shown

GOAL = "navgym goal"  # the study's attribute that says what it is for


def open_study(
    goal: Goal, settings: Mapping[str, Any], name: str, where: Where, storage: BaseStorage
) -> optuna.Study:
    """The study of `goal`, new or continued.

    Args:
        goal: what it minimises.
        settings: what else decides its trials: seed, sampler, ...
        name: of the study.
        where: of the storage, for messages.
        storage: open.

    Raises ValueError if the study there is for something else.
    """
    purpose = _purpose(goal, settings)
    known = {summary.study_name for summary in optuna.get_all_study_summaries(storage=storage)}
    if not is_url(where) and known - {name}:
        raise ValueError(
            f"{where} holds the study {sorted(known)[0]!r}, which navgym did not make: "
            "name another file."
        )
    down = optuna.study.StudyDirection.MINIMIZE
    study = optuna.create_study(
        storage=storage,
        study_name=name,
        directions=[down] * (2 if getattr(goal, "costed", False) else 1),
        load_if_exists=True,
    )
    # trials first: whoever made them has said before what they are for
    begun = bool(study.get_trials(deepcopy=False))
    found = study.user_attrs.get(GOAL)
    if found is None and not begun:
        study.set_user_attr(GOAL, purpose)
    elif found != purpose:
        remedy = (
            "Name another --study."
            if is_url(where)
            else "Name another folder, or move the file away."
        )
        raise ValueError(
            f"{shown(where)} belongs to another search.\n  it holds: {_line(found, purpose)}\n"
            f"  asked for: {_line(purpose, found)}\n{remedy}"
        )
    return study


def _purpose(goal: Goal, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What makes two searches the same, as JSON gives it back."""
    space = [
        f"{p.name} {'|'.join(p.choices) if p.choices else f'{p.low:g}..{p.high:g} {p.scale}'}"
        for p in goal.space
    ]
    text = json.dumps({"space": space, "goal": dict(goal.about), **settings})
    purpose: dict[str, Any] = json.loads(text)
    return purpose


def _line(one: Any, other: Any) -> str:
    """The parts of `one` that `other` does not share, on one line."""
    if isinstance(one, dict) and isinstance(other, dict):
        own = {k: v for k, v in one.items() if other.get(k) != v}
        return "; ".join(f"{k}: {_line(v, other.get(k))}" for k, v in own.items()) or "less"
    return ", ".join(map(str, one)) if isinstance(one, list) else str(one)


def enqueue(study: optuna.Study, space: ParameterSpace, values: Mapping[str, Any]) -> None:
    """Put `values` next in line, unless they are there, at work or done."""
    wanted = to_optuna(space, values)
    states = (TrialState.WAITING, TrialState.RUNNING, TrialState.COMPLETE)
    for trial in study.get_trials(deepcopy=False, states=states):
        if _same(trial.system_attrs.get("fixed_params", trial.params), wanted):
            return
    study.enqueue_trial(wanted)


def _same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return one.keys() == other.keys() and all(
        math.isclose(one[k], other[k], rel_tol=1e-9) if isinstance(other[k], float) else one[k] == other[k]
        for k in other
    )  # fmt: skip
