"""One training from its recordings to its policy; `navgym.agents.training.run.train` is the way in."""

from __future__ import annotations

import importlib.util
import json
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecNormalize

from navgym.agents.policies.manifest import Manifest
from navgym.agents.policies.policy import Policy
from navgym.agents.training import checkpoints, learners
from navgym.agents.training.checkpoints import Checkpoint
from navgym.agents.training.configuration import Configuration, comparable
from navgym.agents.training.learning_curve import write_curve
from navgym.agents.training.log_validation import LogValidation
from navgym.agents.training.material import material
from navgym.agents.training.record import Best, Mark, versions
from navgym.agents.training.validation import Scores, Validation, plain
from navgym.core.atomic import replacing


class Trainer:
    """Recordings, learner, validation and what they made so far.

    Args:
        config: what to do.
        report: takes lines of progress.
        command: that reproduces this, for the manifest.
    """

    def __init__(
        self, config: Configuration, report: Callable[[str], None], command: str = ""
    ) -> None:
        self.config, self.report, self.command = config, report, command
        began = time.perf_counter()
        self.material = material(config)
        self.env = self.material.env
        self.validation: Validation | LogValidation = (
            LogValidation(config) if config.log else Validation(config)
        )
        self.normaliser: VecNormalize = learners.normalised(config, self.env)
        self.model: BaseAlgorithm = learners.learner(config, self.normaliser)
        self.env.seed(int(np.random.SeedSequence(config.seed).generate_state(1)[0]))
        self.portable = config.algorithm not in learners.REMEMBERING
        self.history: list[Mark] = []
        self.best: Best | None = None
        self.cloned: Mapping[str, Any] | None = None
        self._first: Mark | None = None  # of this run, which its pace is measured from
        self._earlier = 0.0  # seconds of runs before an interruption
        self._began = time.perf_counter()
        self.report(
            f"made {self.material.count} training recordings ({self.material.gigabytes:.2f} GB) and "
            f"{self.validation.count} for validation in "
            f"{self._began - began:.0f} s"
        )

    # ---- the stations of a training ----------------------------------------------------------

    def begin(self, kept: Checkpoint | None) -> None:
        """Take up a checkpoint, or start: by cloning, if the configuration says so."""
        sinks = ["tensorboard"] if importlib.util.find_spec("tensorboard") else []
        self.model.set_logger(configure(str(self.config.folder / "tensorboard"), sinks))
        if kept is not None:
            with checkpoints.fitting(self.config.folder):
                self._take_up(kept)
        elif self.config.clone:
            from navgym.agents.training.cloning import clone

            self.cloned = clone(self.config, self.model, self.normaliser, self.env)
            self.env.desynchronise = True
            self.report(f"cloned the table by true regime: {json.dumps(self.cloned['teacher'])}")

    def run(self) -> None:
        """Learn until the configuration's number of decisions."""
        done = self.model.num_timesteps
        if done < self.config.decisions:
            left = self.config.decisions - done
            begun = self.model._last_obs is not None  # a checkpoint was taken up
            self.model.learn(left, callback=_Watch(self), reset_num_timesteps=not begun)
        if not self.history or self.history[-1].decisions < self.model.num_timesteps:
            self.look()

    def finish(self) -> tuple[Policy | None, Mark, tuple[Mark, ...]]:
        """Write what is known of the training; returns the best policy, its mark and all marks."""
        assert self.best is not None
        best, folder = self.best, self.config.folder
        policy = best.policy
        if policy is None:
            self._write_model(best)
        else:  # again: the file may have been lost since
            policy = self._guarded(policy)
            policy.save(folder / "policy")
        facts = {
            "best": best.mark.as_dict(),
            "history": [mark.as_dict() for mark in self.history],
            "cloned": self.cloned,
            "gigabytes": self.material.gigabytes,
            **self._provenance(best.mark),
        }
        with replacing(folder / "training.json", text=True) as file:
            file.write(json.dumps(facts, indent=1, ensure_ascii=False) + "\n")
        write_curve(folder / "training.html", self.config, self.history, best.mark)
        return policy, best.mark, tuple(self.history)

    def _guarded(self, policy: Policy) -> Policy:
        """On logs, the policy if it foretells the fixes better than the tuned parameters, else those."""
        if not isinstance(self.validation, LogValidation):
            return policy
        verdict = self.validation.verdict(policy)
        self.report(str(verdict))
        kept = policy if verdict.better else policy.silent()
        return kept.with_training(guard=verdict.as_dict())

    def _write_model(self, best: Best) -> None:
        """Of a learner that remembers: its own file, and how it normalises observations."""
        folder = self.config.folder
        self.model.set_parameters(checkpoints.unpacked(best.arrays["networks"]))
        with replacing(folder / "model.zip") as file:
            self.model.save(file)  # type: ignore[arg-type]
        recipe = self.config.recipe
        with replacing(folder / "normalisation.npz") as file:
            np.savez(
                file, mean=best.arrays["mean"], variance=best.arrays["variance"],
                clip=recipe.clip_observation, epsilon=self.normaliser.epsilon,
            )  # fmt: skip
        self.report(
            f"{self.config.algorithm} remembers, which a portable policy does not: its model is "
            f"{folder / 'model.zip'}, for sb3_contrib's load, behind {folder / 'normalisation.npz'}"
        )

    # ---- validation and checkpoints ----------------------------------------------------------

    def look(self) -> None:
        """Validate the policy as it is, keep it if it is the best, write a checkpoint."""
        act = self._policy() if self.portable else learners.Remembering(self.model, self.normaliser)
        scores = self.validation(act)
        mark = Mark(self.model.num_timesteps, round(self.seconds, 1), plain(scores))
        self.history.append(mark)
        self._first = self._first or mark
        if self.best is None or mark.score > self.best.mark.score:
            self.best = self._kept(mark, scores)
        for arena, gains in scores.gains.items():
            for name, value in gains.items():
                self.model.logger.record(f"validation/{arena}/{name}", value)
        self.model.logger.record("validation/score", scores.score)
        self.model.logger.dump(self.model.num_timesteps)
        self._save()
        self.report(self._line(mark, scores))

    def _policy(self, scores: Scores | None = None, mark: Mark | None = None) -> Policy:
        training = {} if mark is None else self._provenance(mark)
        low, high = (None, None) if scores is None else (scores.low, scores.high)
        manifest = Manifest.of(self.config.environment, self.env.engine, training)
        columns = self.material.columns
        return Policy.from_sb3(
            self.model, self.normaliser, manifest, low, high, columns, self.config.reach
        )

    def _kept(self, mark: Mark, scores: Scores) -> Best:
        """The policy as it is; a portable one is written at once, so that there always is one."""
        if not self.portable:
            rms: Any = self.normaliser.obs_rms
            networks = checkpoints.packed(self.model.get_parameters())
            arrays = {"networks": networks, "mean": rms.mean.copy(), "variance": rms.var.copy()}
            return Best(mark, None, arrays)
        policy = self._policy(scores, mark)
        policy.save(self.config.folder / "policy")
        return Best(mark, policy)

    def _provenance(self, mark: Mark) -> dict[str, Any]:
        """What a manifest says of the training: nothing that differs between two equal ones."""
        return {
            "command": self.command,
            "configuration": comparable(self.config),
            "seeds": {
                "train": list(self.material.seeds),
                "validation": self.config.draws if self.config.log else self.config.validation,
            },
            "decisions": mark.decisions,
            "validation": dict(mark.scores),
            "versions": versions(),
        }

    @property
    def seconds(self) -> float:
        """Of training, with those of earlier runs."""
        return self._earlier + time.perf_counter() - self._began

    def _line(self, mark: Mark, scores: Scores) -> str:
        """Progress, for people."""
        first = self._first
        assert self.best is not None
        assert first is not None
        done, total = mark.decisions, self.config.decisions
        pace = (mark.seconds - first.seconds) / max(done - first.decisions, 1)
        left = pace * (total - done)
        parts = [f"{min(done / total, 1.0):4.0%}  {done} decisions, {mark.seconds:.0f} s"]
        if left > 1.0:
            parts.append(f"{left:.0f} s to go")
        parts.append(
            f"{100 * scores.gain:+.1f} ± {100 * scores.half:.1f} % against best fixed parameters"
        )
        for name, gains in list(scores.gains.items())[1:]:
            parts.append(f"{name} {100 * next(iter(gains.values())):+.1f} %")
        if scores.diverged:
            parts.append(f"{scores.diverged} diverged")
        parts.append(f"best after {self.best.mark.decisions}")
        return ", ".join(parts)

    def _save(self) -> None:
        assert self.best is not None
        seen = checkpoints.capture(self.model, self.normaliser, self.env)
        arrays, best = self.best.pack()
        facts = {
            "configuration": comparable(self.config),
            "versions": versions(),
            "history": [mark.as_dict() for mark in self.history],
            "best": best,
            "seconds": self.seconds,
            "cloned": self.cloned,
        }
        whole = Checkpoint({**seen.arrays, **arrays}, {**seen.facts, **facts})
        checkpoints.save(self.config.folder / "checkpoints", self.model.num_timesteps, whole)

    def _take_up(self, kept: Checkpoint) -> None:
        checkpoints.apply(kept, self.model, self.normaliser, self.env)
        facts = kept.facts
        self.history = [Mark(**mark) for mark in facts["history"]]
        self.best = Best.unpack(kept.arrays, facts["best"])
        self.cloned, self._earlier = facts["cloned"], float(facts["seconds"])
        self.report(f"going on after {self.model.num_timesteps} decisions")


class _Watch(BaseCallback):
    """Looks at the policy between two updates, where a learner's state is whole."""

    def __init__(self, trainer: Trainer) -> None:
        super().__init__()
        self._trainer = trainer

    def _on_rollout_start(self) -> None:
        trainer = self._trainer
        last = trainer.history[-1].decisions if trainer.history else None
        if (
            last is None
            or self.num_timesteps // trainer.config.interval > last // trainer.config.interval
        ):
            trainer.look()

    def _on_step(self) -> bool:
        return True
