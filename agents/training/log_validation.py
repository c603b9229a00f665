"""How good a policy is on validation logs: paired gain over the tuned parameters that it starts from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from navgym.agents.evaluation.rollout import Learnt, replay_filter, roll_out
from navgym.agents.training.configuration import Configuration
from navgym.agents.training.logs import EARLIER, WHOLE
from navgym.agents.training.validation import Actor, Scores, engine_on, half_width, play
from navgym.agents.training.verdict import Verdict, compared, judged
from navgym.core.checks import Array
from navgym.problem import Run
from navgym.tuning.cases import Cases

FIXES, TRUTH = "fixes", "truth"


class LogValidation:
    """Validation logs of a configuration by rate of losses, or the later parts of its training logs.

    Args:
        config: of the training, its start known.
    """

    def __init__(self, config: Configuration) -> None:
        self.config = config
        judges = config.judges
        span = (EARLIER, 1.0) if judges is None else WHOLE
        self.how = (
            "on the validation logs" if judges else f"on the last {1 - EARLIER:.0%} of each log"
        )
        self.cases = (judges or config.logs).by_rate("validation", config.draws, span)
        self.counts = TRUTH if config.reward != "likelihood" else FIXES
        self.base = {k: self._run(c, dict(config.reference)) for k, c in self.cases.items()}
        self.engines = {
            k: engine_on(config, list(c.recordings), config.reference)
            for k, c in self.cases.items()
        }

    @property
    def count(self) -> int:
        """Recordings."""
        return sum(map(len, self.cases.values()))

    def __call__(self, act: Actor) -> Scores:
        """Gains of a policy over the tuned parameters; the score is their mean over rates of losses."""
        gains: dict[str, Mapping[str, float]] = {}
        lows, highs, diverged, half = [], [], 0, np.nan
        for name, cases in self.cases.items():
            run = self._steered(act, cases)
            found = compared(cases, run, self.base[name])
            gains[name] = {self.counts: found.pop(self.counts), **found}
            diverged += int(run.diverged.sum())
            seen = play(self.engines[name], act)
            lows.append(seen.low)
            highs.append(seen.high)
            if len(gains) == 1:
                half = half_width(self._errors(cases, run), self._errors(cases, self.base[name]))
        score = float(np.mean([each[self.counts] for each in gains.values()]))
        return Scores(score, gains, half, diverged, np.min(lows, axis=0), np.max(highs, axis=0))

    def verdict(self, policy: Any) -> Verdict:
        """Whether a policy foretells the fixes better than the tuned parameters there."""
        gains = [
            compared(c, self._steered(policy, c), self.base[name]) for name, c in self.cases.items()
        ]
        return judged("policy", self.how, gains)

    def _run(self, cases: Cases, parameters: Any) -> Run:
        return cases.problem.run(self.config.filter, cases.batch, parameters, everything=True)

    def _steered(self, act: Any, cases: Cases) -> Run:
        """What the filter makes of the schedules that a policy sets."""
        chooser = Learnt(act)
        found = roll_out(chooser, cases.recordings)
        return cases.problem.run(
            replay_filter(chooser), cases.batch, found.schedules, found.interval, everything=True
        )

    def _errors(self, cases: Cases, run: Run) -> Array:
        """(N,) what counts."""
        return cases.true_errors(run) if self.counts == TRUTH else cases.foretold_errors(run)
