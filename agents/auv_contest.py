"""The AUV's half of the evaluation: conditions, contenders, errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.baselines import (
    PLAIN,
    Random,
    TrueRegime,
    hand_rule,
    has_table,
    whole_filters,
)
from agents.combiner import Combiner
from agents.contest import (
    BEST_FIXED,
    DEFAULT,
    HAND_RULE,
    OTHER,
    OWN,
    REAL,
    SHIFT,
    Condition,
    Contender,
    Labels,
    World,
    choosing,
    short,
)
from agents.rollout import AUV
from navgym._checks import Array
from navgym.estimation import run
from navgym.metrics import consistency, degrees_of_freedom, nees, run_rmse
from navgym.models import LinearModel
from navgym.scenarios import SHIFTS
from navgym.simulation import find_scenario
from tuning.cases import Cases
from tuning.comparison import Entry
from tuning.experiments import RATES, TRACKS, cross_tuned, per_track, real_cases

OTHERS = ("auv/switch-B", "auv/switch-D", "auv/switch-A", "auv/student", "auv/turn")
TABLE = "true-regime table"
QUICK_SHIFTS = ("loss .3", "R x3", "dwell 20-60")
JUDGED = 60  # recordings that consistency is judged on
TRACK_TRIALS, QUICK_TRIALS = 40, 5  # of the study on the other half of the tracks


class AUVWorld(World):
    """Contests of the AUV environment; see `World`."""

    environment, half = AUV, "auv"
    quantities = everywhere = ("rmse",)
    plain, top = PLAIN[AUV], "oracle"
    yardstick = top
    chunk = 100
    _on_tracks: list[Any] | None = None

    def count(self, condition: Condition) -> int:
        """Recordings of a condition; of tracks, the draws of each."""
        return len(TRACKS) * self.size.draws if condition.kind == REAL else self.size.auv

    def conditions(self) -> list[Condition]:
        """Own scenarios, their shifts, other scenarios, real tracks."""
        quick = self.size.quick
        found = list(self.own)
        shifts = {n: SHIFTS[n] for n in QUICK_SHIFTS} if quick else SHIFTS
        for own in self.own:
            found += [
                Condition(name, own.scenario, {**own.overrides, **changes}, SHIFT, own.name)
                for name, changes in shifts.items()
            ]
        others = [s for s in OTHERS if s not in {own.scenario for own in self.own}]
        found += [Condition(short(s), s, {}, OTHER) for s in (others[:1] if quick else others)]
        if self.folder is not None:
            rates = RATES[1:2] if quick else RATES
            found += [Condition(f"tracks, {100 * r:.0f} % lost", kind=REAL, loss=r) for r in rates]
        return found

    def cases(self, condition: Condition, start: int, count: int) -> Cases:
        """Test recordings."""
        if condition.kind == REAL:
            every = real_cases(self.folder, condition.loss, self.size.draws, "test")
            return every.take(range(start, start + count))
        return Cases.simulated(
            condition.scenario, "test", count, start, **dict(condition.overrides)
        )

    def contenders(self, condition: Condition, cases: Cases) -> list[Contender]:
        """From the plain filter to the oracle."""
        tracks = condition.kind == REAL
        whole = {e.label: Contender(e) for e in whole_filters(AUV, truth=not tracks)}
        found = [whole.pop(PLAIN[AUV])]
        found += [Contender(Entry("kf_extrapolate", "kf_extrapolate"))] if tracks else []
        found += [choosing("random", Random(AUV), cases)] if condition.kind == OWN else []
        found.append(Contender(Entry(DEFAULT, "qivbf")))
        found.append(choosing(HAND_RULE, hand_rule(AUV), cases))
        found += [Contender(e) for e in self._fixed(condition, cases)]
        found += self.learners(condition, cases)
        found += [self._table(condition, cases)] if has_table(condition.scenario) else []
        oracle = [whole.pop("oracle")] if "oracle" in whole else []
        combined = [Contender(Entry(k, "bank"), runs=c) for k, c in self.combiners.items()]
        return [*found, *whole.values(), *combined, *oracle]

    def _fixed(self, condition: Condition, cases: Cases) -> list[Entry]:
        """The best fixed parameters here, and the policies' own where they are others."""
        if condition.kind == REAL:
            found = [Entry(BEST_FIXED, "qivbf", self._tuned_on_tracks(cases))]
            others = self.references(None)
        else:
            here = dict(find_scenario(condition.scenario).reference)
            found, others = [Entry(BEST_FIXED, "qivbf", here)], self.references(here)
        return found + [Entry(label, "qivbf", own) for label, own in others.items()]

    def _tuned_on_tracks(self, cases: Cases) -> list[Any]:
        """Per recording, QIVBF's parameters tuned on the other half of the tracks."""
        if self._on_tracks is None:
            draws, entry = max(self.size.draws // 2, 1), Entry("qivbf", "qivbf")
            trials = QUICK_TRIALS if self.size.quick else TRACK_TRIALS
            self._on_tracks = list(cross_tuned(entry, self.folder, draws, trials))
        return per_track(cases, self._on_tracks)

    def _table(self, condition: Condition, cases: Cases) -> Contender:
        reference = find_scenario(condition.scenario).reference
        regimes = [r.regime for r in cases.recordings]
        table = TrueRegime(AUV, condition.scenario, regimes, cases.regimes, reference)
        return Contender(Entry(TABLE, "qivbf", table.schedules(), bound=True, interval=1))

    # ---- what runs come to

    def run(self, contender: Contender, cases: Cases) -> tuple[Array, NDArray[Any]]:
        """See `World`."""
        found = self._all(contender, cases, contender.entry.parameters, everything=False)
        return found["states"], found["diverged"]

    @staticmethod
    def _all(
        contender: Contender, cases: Cases, parameters: Any, everything: bool
    ) -> dict[str, Array]:
        """What a contender says of each sample."""
        if isinstance(contender.runs, Combiner):
            return contender.runs.run(cases.batch, everything, fallback=True)
        entry = contender.entry
        return run(entry.filter, cases.batch, parameters, entry.interval or 1, everything)

    def errors(self, cases: Cases, states: Array, names: Sequence[str]) -> dict[str, Array]:
        """Position RMSE, m."""
        return {name: run_rmse(cases.squared(states)) for name in names}

    def seconds(self, cases: Cases, states: Array) -> Array:
        """Squared position errors, m²: a sample is a second."""
        return cases.squared(states)

    def labels(self, cases: Cases) -> list[Labels]:
        """See `World`."""
        if len(cases.regimes) < 2:
            return []
        return [Labels(r.regime, {"regimes": cases.regimes}) for r in cases.recordings]

    def times(self, cases: Cases) -> Array:
        """See `World`."""
        found: Array = cases.recordings[0].time
        return found

    def consistency(self, contender: Contender, cases: Cases) -> dict[str, float]:
        """See `World`; NEES of all states."""
        some = cases.take(range(min(JUDGED, len(cases))))
        parameters = contender.entry.parameters
        if isinstance(parameters, list):
            parameters = parameters[: len(some)]
        found = self._all(contender, some, parameters, everything=True)
        dof = degrees_of_freedom(some.batch.lost)
        nis = consistency(found["nis"], dof)
        assert some.batch.truth is not None
        normalised = nees(found["states"], found["covariances"], some.batch.truth)
        heard = dof[np.isfinite(found["nis"]) & (dof > 0)]
        return {
            "nis": nis.mean * nis.samples / float(heard.sum()),
            "inside": nis.inside,
            "nees": float(np.nanmean(normalised)) / found["states"].shape[-1],
        }


def serves(scenario: str) -> None:
    """Raise ValueError unless the environment can play `scenario`."""
    found = find_scenario(scenario)
    if not isinstance(getattr(found, "model", None), LinearModel):
        raise ValueError(  # noqa: TRY004
            f"a policy of {AUV} cannot serve {scenario!r}, whose model is nonlinear: choose a "
            "scenario with a linear one, such as 'auv/switch-D'."
        )
