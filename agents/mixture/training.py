"""Train a mixture: experts around the tuned filter, weights by least squares, and a guard that may say no."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from navgym.agents.combiner.combiner import combines
from navgym.agents.mixture.experts import Expert, around, known
from navgym.agents.mixture.material import Lessons, lessons_of, material
from navgym.agents.mixture.mixture import Mixture
from navgym.agents.training.logs import EARLIER, WHOLE, Logs, judging
from navgym.agents.training.reference import Start, found_start
from navgym.agents.training.verdict import Verdict, compared, judged
from navgym.core.atomic import writable_folder
from navgym.core.checks import Array, one_of, positive_int, within
from navgym.core.seeds import seeds
from navgym.core.storage import writable
from navgym.core.streams import say
from navgym.statespace.filters import mixture as kernels
from navgym.tuning import declared

Report = Callable[[str], None]
MOST_FOLDS = 6  # of leaving a log out, for the guard


@dataclass(frozen=True)
class MixtureConfiguration:
    """A mixture of fixed filters around a tuned one: trained on logs in seconds, without torch."""

    log: tuple[Path, ...] = ()
    """logs to train on: files, or with formats that are folders, folders"""
    validation_log: tuple[Path, ...] = ()
    """logs that judge it; without them each log is judged by weights trained on the others, and one log
    alone is cut in time"""
    read: tuple[str, ...] = ()
    """what the logs' reader is told: pairs of an option and its value, before them, if you like, a mapping
    file"""
    format: str | None = None
    """of the logs; by default what they look like"""
    filter: str = "qivbf"
    """the tuned filter that the experts stand around; with start, that file's"""
    start: Path | None = None
    """a tuned.toml to start from; by default the filter is tuned on the same logs with the same information"""
    trials: int = 150
    """of that tuning"""
    truth: bool = True
    """whether to learn from the truth where all logs have it; else from one-step errors of the fixes"""
    draws: int = 5
    """of noise and losses per log and rate of losses, where the format draws them"""
    decay: float = 0.001
    """of the squared weights"""
    iterations: int = 60
    """of the optimiser, at most"""
    seed: int = 0
    """of everything random"""
    out: Path | None = None
    """folder of mixture.npz, mixture.json and tuned.toml; default: runs/train/mixture-SEED"""

    def __post_init__(self) -> None:
        one_of("filter", self.filter, known())
        for name in ("trials", "draws", "iterations"):
            positive_int(name, getattr(self, name))
        positive_int("seed", self.seed, least=0)
        within("decay", self.decay, 0.0)

    @property
    def folder(self) -> Path:
        """Where everything is written."""
        return self.out or Path("runs/train") / f"mixture-{self.seed}"

    @property
    def logs(self) -> Logs:
        """What it is trained on; ValueError for none, logs of different problems, or of one without a bank."""
        found = Logs(self.log, self.read, self.format)
        if not combines(found.problem):
            raise ValueError(
                f"{self.log[0].name} is a log of the {found.problem.title}, and a mixture is made of filters "
                "for vehicles with position fixes: name logs of those."
            )
        return found

    @property
    def judges(self) -> Logs | None:
        """The logs that judge it, where they are others.

        Raises ValueError for one that is also trained on, or of another problem.
        """
        return judging(self.logs, self.validation_log)


@dataclass(frozen=True, eq=False)
class Made:
    """What a training made.

    Args:
        mixture: that is written: of all experts, or the tuned filter alone where the guard said no.
        tried: the mixture of all experts in any case.
        verdict: what the guard found.
        start: the tuned parameters.
        folder: where it is.
        seconds: of learning weights, the guard's included.
    """

    mixture: Mixture
    tried: Mixture
    verdict: Verdict
    start: Start
    folder: Path
    seconds: float


def train(config: MixtureConfiguration, report: Report = say, command: str = "") -> Made:
    """Tune, or read what is tuned; learn the weights; let the guard judge; write.

    Raises:
        FileNotFoundError: a log that is not there.
        ValueError: logs of different problems, without fixes, too short, or of no linear model.
    """
    folder = writable_folder("out", config.folder)
    logs, judges = config.logs, config.judges
    rng = np.random.default_rng(np.random.SeedSequence([0x3E, config.seed]))
    sees = config.truth and has_truth(logs)
    report(by_what(sees, config.truth))
    start = found_start(config, logs, sees, report)
    start.save(folder / "tuned.toml", command)
    began = time.perf_counter()
    experts = around(Expert(start.filter, start.parameters))
    lessons = lessons_of(logs.recordings("train", config.draws), sees, logs.drawn, rng)
    taught = material(experts, lessons, sees)
    report(
        f"{len(lessons)} lessons of {len(experts)} experts in {time.perf_counter() - began:.1f} s"
    )
    tried = fitted(experts, taught, config)
    verdict = guarded(config, experts, taught, logs, judges, tried)
    report(str(verdict))
    seconds = time.perf_counter() - began
    facts = provenance(config, command, start, verdict, sees)
    tried = dataclasses.replace(tried, training=facts)
    kept = tried if verdict.better else Mixture.single(experts[0], facts)
    kept.save(folder / "mixture")
    return Made(kept, tried, verdict, start, folder, seconds)


def has_truth(logs: Logs) -> bool:
    """Whether every log has a truth."""
    return all(cases.has_truth for cases in logs.by_rate("train", 1).values())


def by_what(sees: bool, wanted: bool) -> str:
    """What is learnt from, in words."""
    if sees:
        return "learning from the truth that the logs hold"
    why = "the logs hold no truth" if wanted else "the truth is not looked at"
    return f"{why}: learning from how well each fix is foretold one step ahead"


def provenance(
    config: MixtureConfiguration, command: str, start: Start, verdict: Verdict, sees: bool
) -> dict[str, Any]:
    """What a mixture's file says of its making: nothing that names a machine's folders."""
    own = declared.as_dict(dataclasses.replace(config, out=None, start=None))
    own["log"] = [p.name for p in config.log]
    own["validation_log"] = [p.name for p in config.validation_log]
    return writable(
        {
            "command": command, "configuration": own, "learnt_from": "truth" if sees else "fixes",
            "tuned": start.about, "guard": verdict.as_dict(),
            "seeds": {"train": _ends("train", config), "validation": _ends("validation", config)},
        }
    )  # fmt: skip


def _ends(split: str, config: MixtureConfiguration) -> list[int]:
    chosen = seeds(split, config.draws)
    return [chosen.start, chosen.stop - 1]


# ---- weights


def fitted(experts: Sequence[Expert], lessons: Lessons, config: MixtureConfiguration) -> Mixture:
    """The mixture of `experts` whose weights suit the lessons best.

    Minimises Σ worth |Σ w_j e_j|² over a softmax w of the features, plus decay Σ W².

    Raises ValueError where there is nothing to learn from.
    """
    if not len(lessons.features):
        raise ValueError(
            "the logs hold no rows to learn from: they are too short, or hold no fixes."
        )
    shift = lessons.features.mean(axis=0, dtype=np.float64)
    gain = 1.0 / np.maximum(lessons.features.std(axis=0, dtype=np.float64), 1e-2)
    z = np.clip((lessons.features - shift) * gain, -kernels.CLIP, kernels.CLIP)
    loss = _Loss(z, lessons, config.decay)
    begin = np.zeros((z.shape[1] + 1, len(experts)))
    limits: Any = {"maxiter": config.iterations}
    found: Any = minimize(loss, begin.ravel(), jac=True, method="L-BFGS-B", options=limits)
    W = found.x.reshape(begin.shape)
    low, high = (f(lessons.features, axis=0).astype(np.float64) for f in (np.min, np.max))
    return Mixture(tuple(experts), shift, gain, low, high, W[:-1], W[-1])


class _Loss:
    """The loss over weights, the biases last, and its gradient; 1 where the reference has all weight."""

    def __init__(self, z: Array, lessons: Lessons, decay: float) -> None:
        own = (lessons.errors[:, 0].astype(np.float64) ** 2).sum(axis=1)
        worth = lessons.worth / max(float(lessons.worth @ own), 1e-30)
        self.facts = (z, lessons.errors, worth, lessons.able)
        self.decay = decay

    def __call__(self, x: Array) -> tuple[float, Array]:
        W = x.reshape(self.facts[0].shape[1] + 1, -1)
        slope = np.empty_like(W)
        total = kernels.learn(  # type: ignore[no-untyped-call]
            *self.facts, W[:-1], W[-1], slope[:-1], slope[-1]
        )
        slope[:-1] += 2.0 * self.decay * W[:-1]
        return float(total) + self.decay * float((W[:-1] ** 2).sum()), slope.ravel()


# ---- the guard


def guarded(
    config: MixtureConfiguration,
    experts: Sequence[Expert],
    lessons: Lessons,
    logs: Logs,
    judges: Logs | None,
    tried: Mixture,
) -> Verdict:
    """Whether weights beat the tuned filter on logs, or on a stretch, that they were not trained on."""
    if judges is not None:
        how = "on the validation logs"
        pairs = [_pair(tried, judges, config, WHOLE)]
    elif len(logs) == 1:
        how = f"on the last {1 - EARLIER:.0%} of the one log, trained on what is before"
        before = fitted(experts, lessons.take(lessons.share < EARLIER), config)
        pairs = [_pair(before, logs, config, (EARLIER, 1.0))]
    else:
        how = "on each log, trained on the others"
        folds = np.array_split(np.arange(len(logs)), min(len(logs), MOST_FOLDS))
        pairs = []
        for fold in folds:
            others = fitted(experts, lessons.take(~np.isin(lessons.log, fold)), config)
            pairs.append(_pair(others, logs.only(fold.tolist()), config, WHOLE))
    return judged("mixture", how, [gain for pair in pairs for gain in pair])


def _pair(
    mixture: Mixture, logs: Logs, config: MixtureConfiguration, span: tuple[float, float]
) -> list[Mapping[str, float]]:
    """Gains over the tuned filter by rate of losses."""
    found: list[Mapping[str, float]] = []
    for cases in logs.by_rate("validation", config.draws, span).values():
        reference = mixture.reference
        base = cases.problem.run(
            reference.filter, cases.batch, dict(reference.parameters), everything=True
        )
        found.append(compared(cases, mixture.run(cases.batch, everything=True), base))
    return found
