"""Train a policy: recordings once, a learner, validation at intervals, the best one kept.

A training can be stopped at any time, also by SIGKILL: the same call goes on from its last
checkpoint, and ends with the policy that an uninterrupted one ends with, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from navgym.agents.policies.policy import Policy
from navgym.agents.training import checkpoints
from navgym.agents.training.checkpoints import Checkpoint, Report
from navgym.agents.training.configuration import Configuration, comparable, current
from navgym.agents.training.record import Mark, versions
from navgym.agents.training.trainer import Trainer
from navgym.core.atomic import replacing, writable_folder


@dataclass(frozen=True)
class Trained:
    """What a training made.

    Args:
        policy: the best one on validation recordings; None where the learner remembers, so that it
            cannot be written portably.
        best: its validation.
        history: every validation.
        folder: where everything is.
    """

    policy: Policy | None
    best: Mark
    history: tuple[Mark, ...]
    folder: Path


def train(
    config: Configuration, fresh: bool = False, report: Report = print, command: str = ""
) -> Trained:
    """Train as `config` says, or go on with what is in its folder.

    Args:
        config: see `Configuration`; `config.folder` receives the policy, checkpoints and logs.
        fresh: start anew, whatever the folder holds.
        report: takes lines of progress.
        command: that reproduces this, for the manifest.

    Raises:
        ValueError: the folder holds another training; recordings that take too much memory.
        ModuleNotFoundError: the algorithm needs sb3-contrib.
    """
    folder = writable_folder("out", config.folder)
    kept = None
    if fresh:
        checkpoints.clear(folder / "checkpoints")
    else:
        kept = _continued(config, report)
    with replacing(folder / "config.toml", text=True) as file:
        file.write(config.to_toml())
    trainer = Trainer(config, report, command)
    trainer.begin(kept)
    trainer.run()
    return Trained(*trainer.finish(), folder)


def _continued(config: Configuration, report: Report) -> Checkpoint | None:
    """The checkpoint to go on from, if there is one; ValueError if it is of another training."""
    found = checkpoints.to_continue(config.folder, comparable(config), report, current)
    if found is None:
        return None
    today = versions()
    with checkpoints.fitting(config.folder):
        before = found.facts["versions"].items()
    changed = [f"{k} {v} then, {today.get(k)} now" for k, v in before if today.get(k) != v]
    if changed:
        report(f"the checkpoint is of other versions ({', '.join(changed)}): bits may differ")
    return found
