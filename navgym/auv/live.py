"""The AUV's environment on live data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.auv import kernels as K
from navgym.auv.engine import observation_names, station_of
from navgym.auv.intake import LinearIntake, Model, doubtful
from navgym.auv.settings import AUVDropoutSettings
from navgym.core.checks import Array
from navgym.core.health import NUMERICAL
from navgym.envs.columns import TALLY
from navgym.envs.live import CONTROLLED, REFERENCE, LiveLane, pooled
from navgym.statespace.filters import kalman, qivbf

FROZEN = 2  # beside CONTROLLED and REFERENCE
BOTH = 3  # bits of the two adaptive filters


class _Memory:
    """All that changes as samples come in, in one block, and its pieces.

    Args:
        block: of bytes.
        pieces: arrays that lie in it.
    """

    def __init__(self, block: NDArray[np.uint8], pieces: list[NDArray[Any]]) -> None:
        self.block = block
        self.lanes, self.frozen, self.stations, self.model, self.sample, self.doubt, self.tally = (
            pieces
        )


class LiveAUV(LinearIntake, LiveLane):
    """QIVBF twice, and the frozen Kalman filter beside it.

    Args:
        settings: of the environment.
        reference: parameters of the reference filter; residual actions start from them.
        model: see `LinearIntake`.
        interval: likewise.
        rates: not for this filter.

    Raises:
        TypeError: a model of another kind.
        ValueError: an interval that is not positive.
    """

    def __init__(
        self,
        settings: AUVDropoutSettings,
        reference: Mapping[str, Any],
        model: Model,
        interval: float | None = None,
        rates: bool = False,
    ) -> None:
        LiveLane.__init__(self, settings, reference, observation_names(settings.action_parameters))
        if rates:
            raise ValueError("rates= is for filters of IMUs: leave it out.")
        LinearIntake.__init__(self, model, interval)
        n, m = self.model.n, self.model.m
        self.components = m
        station = station_of(self.model, self.reference)
        self.fixes = bool((station["kind"] == 0).any())
        types = (
            (qivbf.lane_type(n, m), 2), (kalman.lane_type(n, m), 1), (station.dtype, 2),
            (self._packed.dtype, 1), (K.tape_type(n, m), 1), (K.doubt_type(m), 3),
            (np.float64, TALLY),
        )  # fmt: skip
        self._now = now = _Memory(*pooled(*types))
        self._past = [_Memory(*pooled(*types)) for _ in range(K.AGREEING)]
        self.lanes, self._frozen, self.stations, self.tally = (
            now.lanes, now.frozen, now.stations, now.tally,
        )  # fmt: skip
        self._model, self._sample, self._doubt = now.model, now.sample, now.doubt
        self._arguments = (
            self.lanes, self._frozen, self.stations, self._model, self._sample, self._doubt,
            self.table, self.tally,
        )  # fmt: skip
        self._views = [tuple(self.lanes[n][i : i + 1] for n in ("x", "P", "nis")) for i in (0, 1)]
        self.reset()

    def reset(self) -> None:
        """Go back to x0, P0, one step before the first sample."""
        self._begin_samples()
        self.tally[:] = 0.0
        self._begin_filters()
        self.stations[...] = station_of(self.model, self.reference)
        self.observation[...] = 0.0
        K.first_look(self.stations[:1], self.table, self.observation)  # type: ignore[no-untyped-call]

    # ---- samples ---------------------------------------------------------------------------

    def ready(self) -> bool:
        """Whether there is a sample to filter."""
        return self._waiting

    def step(self, look: bool) -> int:
        """Filter the sample; with `look` write the observation.

        Returns bits of the filters that failed or lost the track, and were started again: 1 the
        controlled one, 2 the reference, 3 both.
        """
        self._waiting = False
        self.k += 1
        self._past[self.k % len(self._past)].block[...] = self._now.block
        failed = self._call(K.live, (*self._arguments, look, self.observation))
        if failed:
            failed = self._recover(failed, look)
        return failed

    def answer(self, which: int) -> tuple[Array, Array, float]:
        """State, covariance and NIS of the controlled or the reference filter, copied."""
        x, P, nis = self._views[which]
        return x[0].copy(), P[0].copy(), nis.item()

    # ---- failures ----------------------------------------------------------------------------

    def _recover(self, failed: int, look: bool) -> int:
        """Mend what failed at this sample; returns the bits of the filters that were started again."""
        if (self.lanes["diverged"] == NUMERICAL).all():
            self._leave_out(look)
            return BOTH
        lost = sum(1 << i for i in (CONTROLLED, REFERENCE) if failed >> 3 + i & 1 and self._off(i))
        bad = (failed & BOTH) | lost
        if bad == BOTH:
            self._take_again(look)
        elif bad:
            self._heal(bad)
        if self._frozen["diverged"][0] == NUMERICAL:
            kalman.begin(self._frozen, self._model[None], self.reference[None])
            self._frozen["x"], self._frozen["P"] = (self.lanes[n][REFERENCE] for n in ("x", "P"))
            self._doubt[FROZEN] = self._doubt[REFERENCE]
        return bad

    def _heal(self, failed: int) -> None:
        super()._heal(failed)
        bad = CONTROLLED if failed & 1 else REFERENCE
        self._doubt[bad] = self._doubt[1 - bad]

    def _before(self, back: int) -> _Memory:
        """What was kept when the sample `back` ones ago had come and was not yet filtered."""
        return self._past[(self.k - back) % len(self._past)]

    def _leave_out(self, look: bool) -> None:
        """The sample broke the numbers of both filters: it counts as lost."""
        self._now.block[...] = self._before(0).block
        self._lost[...] = 1
        if self._call(K.live, (*self._arguments, look, self.observation)) & BOTH:
            self._begin_filters()  # it was not the sample
        self.tally[:] = 0.0

    def _off(self, which: int) -> bool:
        """Whether innovations that agree lie far off what was believed before the first of them.

        That is FAR standard deviations of the prediction and of the usual innovations together:
        noise that is much larger than the model's is no loss of the track. Where it is none, as
        many innovations must agree again before this is asked the next time.
        """
        before = self._before(min(self.k, K.AGREEING) - 1)
        model, doubt = before.model[0], self._doubt[which]
        predicted = model["F"] @ before.lanes["P"][which] @ model["F"].T + model["Q"]
        believed = np.diag(model["H"] @ predicted @ model["H"].T) / np.diag(model["R"])
        usual = np.exp(np.maximum(before.doubt["usual"][which], 0.0))
        agree = doubt["run"] >= K.AGREEING
        off = doubt["last"] ** 2 > K.FAR**2 * (usual + believed)
        doubt["run"][agree] = 0
        return bool((off & agree).any())

    def _take_again(self, look: bool) -> None:
        """The track is lost: go back to before the innovations that agree, widen, take them again.

        One sample far off is an outlier, or the vehicle is elsewhere: nothing can tell, and the
        filters leave it to their noise. Of AGREEING that are far off and near one another all would
        have to be wrong alike. So the state before the first of them is given up as far as they
        contradict it: what they see may be off by their miss, its rate by what the miss changed by
        from one to the next, and everything by P0. What was learnt of the noise till then stands.
        """
        kept = [self._before(back) for back in reversed(range(min(self.k, K.AGREEING)))]
        samples = [(each.model.copy(), each.sample.copy()) for each in kept]
        miss = self._doubt["last"].copy()
        change = miss - kept[-1].doubt["last"]
        rows = self.stations["row"].copy()
        self._now.block[...] = kept[0].block
        self.stations["row"] = rows
        known = [(lane, lane[list(names)].copy()) for lane, names in self._lasting()]
        self._begin_filters()
        for i, (lane, values) in enumerate(known):
            for name in values.dtype.names or ():
                lane[name] = values[name]
            lane["P"] += doubtful(self._model[0], miss[i], change[i])
        for model, sample in samples:
            self._model[...], self._sample[...] = model, sample
            if self._call(K.live, (*self._arguments, look, self.observation)) & BOTH:
                self._begin_filters()
        self.tally[:] = 0.0

    def _lasting(self) -> list[tuple[NDArray[Any], tuple[str, ...]]]:
        """The three filters, and of each what outlasts a lost track."""
        adaptive = ("x", "P", "R", "count", "variances")
        return [(self.lanes[:1], adaptive), (self.lanes[1:], adaptive), (self._frozen, ("x", "P"))]

    def _begin_filters(self) -> None:
        """All three filters at x0, P0 of the model."""
        kalman.begin(self._frozen, self._model[None], self.reference[None])
        qivbf.begin(self.lanes, self._model[None], self.reference[None, None])
        self._doubt[...] = np.zeros((), self._doubt.dtype)
