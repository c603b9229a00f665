"""Train a policy: recordings once, a learner, validation at intervals, the best one kept.

A training can be stopped at any time, also by SIGKILL: the same call goes on from its last
checkpoint, and ends with the policy that an uninterrupted one ends with, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from navgym.agents.policies.policy import Policy
from navgym.agents.training import checkpoints
from navgym.agents.training.checkpoints import Checkpoint, Report
from navgym.agents.training.configuration import Configuration, comparable, current
from navgym.agents.training.logs import EARLIER
from navgym.agents.training.record import Mark, versions
from navgym.agents.training.reference import found_start
from navgym.agents.training.trainer import Trainer
from navgym.core.atomic import replacing, writable_folder
from navgym.core.streams import say


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
    config: Configuration, fresh: bool = False, report: Report = say, command: str = ""
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
    if config.log:
        config = settled(config, fresh, report, command)
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


def settled(config: Configuration, fresh: bool, report: Report, command: str) -> Configuration:
    """A training on logs with its start known: tuned parameters, in the folder's tuned.toml.

    What an earlier call has tuned there is taken up, unless all is begun anew.
    """
    folder, logs = config.folder, config.logs
    cases = logs.by_rate("train", 1).values()
    sees = config.truth and all(c.has_truth for c in cases)
    if not sees:
        report(
            "the truth is not known or not looked at: the policy learns from the likelihood, which teaches "
            "little on real tracks; --kind mixture learns from the fixes"
        )
    if config.judges is None:
        report(f"the last {1 - EARLIER:.0%} of each log in time choose and judge the policy")
    path = folder / "tuned.toml"
    if fresh or not path.is_file() or not (folder / "checkpoints").is_dir():
        start = found_start(config, logs, sees, report)
        if start.filter != config.filter:
            raise ValueError(
                f"{config.start} holds parameters of {start.filter!r}, and {config.environment} sets those "
                f"of {config.filter!r}: tune that filter."
            )
        start.save(path, command)
    return replace(config, start=path, reward=config.reward if sees else "likelihood")


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
