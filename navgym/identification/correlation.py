"""The empirical autocorrelation of relative-attitude increments (IDAM eq. 20)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from navgym.core.checks import Array, positive_int, real_array, within

LEAST_LAGS = 20  # of a usual record: with fewer, three parameters are rough
USUAL_STEP, USUAL = 0.5, 4 * LEAST_LAGS  # s, and increments over it, of the shortest usual record
FEWEST, FEWEST_LAGS = 24, 8  # increments and lags of the shortest record that is looked at
LONGEST = 60.0  # s, default of the longest lag, unless the record is shorter than four times that


@dataclass(frozen=True)
class Correlation:
    """What a record of increments tells about its autocorrelation.

    Args:
        step: t0, s; each increment spans it.
        duration: s, of received data.
        lags: (L,) s, t0, 2 t0, …; lag 0 is left out, since white gyro noise is in it, and since
            increments that overlap don't follow eq. 23.
        values: (L, 3) autocorrelation there, rad².
        variance: (3,) at lag 0, gyro noise included, rad².
        increments: (K, 3) consecutive increments over t0, rad; NaN where one was not received.
    """

    step: float
    duration: float
    lags: Array
    values: Array
    variance: Array
    increments: Array

    @property
    def short(self) -> bool:
        """Whether the record is shorter than the asymptotic formulas of its errors can bear."""
        return bool(self.duration < USUAL * max(self.step, USUAL_STEP) * (1.0 - 1e-9))


def correlate(
    increments: ArrayLike,
    interval: float,
    step: float | None = None,
    longest_lag: float | None = None,
    fewest: int = FEWEST,
) -> Correlation:
    """Estimate the autocorrelation of increments over `step` s at lags that are multiples of it.

    The increments over t0 begin at each sample, so that none is wasted, and their mean is taken
    off: it holds the difference of the gyros' biases. A pair enters only if both its increments
    were received in full.

    Args:
        increments: (T, 3) rad, θ_k − θ_{k−1} plus gyro noise, in inertial axes; NaN where missing.
        interval: s, that each of them spans.
        step: t0, s, rounded to a multiple of `interval`. .25-1 s is a good choice: at 10 ms, σ² is
            ill-conditioned (IDAM eq. 24). By default .5 s, or less where the record holds fewer
            than 80 of those.
        longest_lag: s, from 20 steps (8 where the record holds fewer than 80) to half the record;
            by default a quarter of it, at most 60 s.
        fewest: received increments over `step` below which a record is refused.

    Raises:
        ValueError: data or options that cannot be used, or too short a record.
    """
    data = _checked(increments)
    interval = within("interval", interval, 0.0, above=True)
    received = np.isfinite(data).all(axis=1)
    duration = float(received.sum()) * interval
    if step is None:
        step = max(min(USUAL_STEP, duration / USUAL), interval)
        step = interval * max(np.floor(step / interval * (1.0 + 1e-9)), 1.0)
    step = within("step", step, interval * (1.0 - 1e-9))
    whole = round(step / interval)
    step = whole * interval
    lags = _lags(step, duration, longest_lag, positive_int("fewest", fewest, FEWEST))
    sums = _sums(data, whole)
    pairs = min(2 * LEAST_LAGS, int(duration / step) // 2)
    values = _masked(sums - np.nanmean(sums, axis=0), lags.size, whole, pairs)
    return Correlation(step, duration, lags, values[1:], values[0], sums[::whole])


def _checked(increments: ArrayLike) -> Array:
    """(T, 3) rows that are either finite or missing."""
    if isinstance(increments, np.ma.MaskedArray):
        increments = np.where(np.ma.getmaskarray(increments), np.nan, np.ma.getdata(increments))
    data = real_array("increments", increments, finite=False)
    if data.ndim != 2 or data.shape[1] != 3:
        raise ValueError(
            f"increments must have shape (T, 3), one column per axis, got {data.shape}."
        )
    if np.isinf(data).any():
        raise ValueError("increments must be finite, or NaN where missing, got infinities.")
    data[np.isnan(data).any(axis=1)] = np.nan
    there = data[~np.isnan(data[:, 0])]
    still = [name for name, x in zip("xyz", there.T, strict=True) if x.size and np.ptp(x) == 0.0]
    if still:
        raise ValueError(
            f"increments on axis {', '.join(still)} are {there[0, 'xyz'.index(still[0])]:g} "
            "throughout: there is no flexure to identify. Give the axis a model of your own, for "
            "example with a tiny sigma."
        )
    return data


def _lags(step: float, duration: float, longest: float | None, fewest: int) -> Array:
    """(L,) the lags to look at, s."""
    count = duration / step * (1.0 + 1e-9)
    if count < fewest:
        raise ValueError(
            f"increments hold {duration:g} s of received data, and {fewest * step:g} s are needed at "
            f"step={step:g} s ({fewest} increments): record longer, or choose a smaller step."
        )
    least = LEAST_LAGS if count >= USUAL else FEWEST_LAGS
    if longest is None:
        longest = max(min(duration / 4.0, LONGEST), least * step)
    longest = within("longest_lag", longest, least * step * 0.999, duration / 2.0)
    return step * np.arange(1.0, round(longest / step) + 1.0)


def _sums(data: Array, whole: int) -> Array:
    """(T − whole + 1, 3) increments over `whole` samples, beginning at each; NaN beside gaps."""
    window = np.lib.stride_tricks.sliding_window_view(data, whole, axis=0)
    return np.asarray(window.sum(axis=-1)) if whole < 8 else _running(data, whole)


def _running(data: Array, whole: int) -> Array:
    """The same by differences of a running total, which costs nothing for long windows."""
    missing = np.isnan(data[:, 0])
    total = np.cumsum(np.vstack((np.zeros(3), np.where(missing[:, None], 0.0, data))), axis=0)
    lost = np.cumsum(np.concatenate(([0], missing)))
    sums = total[whole:] - total[:-whole]
    sums[lost[whole:] > lost[:-whole]] = np.nan
    return np.asarray(sums)


def _masked(data: Array, lags: int, whole: int, least: int) -> Array:
    """(lags + 1, 3) mean of x_k x_{k+n·whole} over the pairs of which both are there."""
    there = np.isfinite(data[:, 0])
    size = fft.next_fast_len(len(data) + lags * whole, real=True)
    columns = np.column_stack((np.where(there[:, None], data, 0.0), there))
    spectrum = np.abs(fft.rfft(columns, size, axis=0)) ** 2
    products = fft.irfft(spectrum, size, axis=0)[: lags * whole + 1 : whole]
    pairs = np.round(products[:, 3:])
    if (pairs < least).any():
        raise ValueError(
            f"increments leave only {int(pairs.min())} pairs at some lag: gaps are too many. "
            "Choose a smaller longest_lag or step."
        )
    return np.asarray(products[:, :3] / pairs)
