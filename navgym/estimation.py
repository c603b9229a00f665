"""Run a filter over a recording: the one road from (recording, parameters) to an estimate."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from navgym import exports
from navgym.core.checks import Array, one_of
from navgym.core.parameters import ParameterSpace
from navgym.core.tables import write_table
from navgym.metrics.whiteness import whiteness
from navgym.problem import PROBLEMS, Filter, Problem, Run, load, problem_of, problems, problems_with
from navgym.tuned import settled

if TYPE_CHECKING:
    from navgym.deck.estimation import DeckEstimate
    from navgym.deck.recording import DualIMURecording
    from navgym.statespace.recording import Recording

Parameters = Mapping[str, Any] | ArrayLike | str | os.PathLike[str] | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """What a filter made of one recording of T filter steps.

    Args:
        time: (T,) s, of each state.
        states: (T, n) posterior means; NaN after a numerical failure.
        covariances: (T, n, n) posterior covariances.
        innovations: (T, m) measurement minus its prediction; NaN where lost.
        nis: (T,) normalised innovation squared under the predicted covariance, chi-square with as
            many degrees of freedom as components were received; NaN where nothing was.
        log_likelihood: (T,) of each innovation, same convention.
        diverged: True after a numerical failure, or once the filter has lost the track: it has
            foretold its measurements, for a while, far worse than who repeats the last ones (a deck's:
            its innovations have been a hundred times what it believes).
        extras: further outputs of some filters, such as a bank's mode weights.
        recording: what was filtered, for plots and exports; None where a filter was run otherwise.
        parameters: as the filter was given them; None for its defaults.
    """

    time: Array
    states: Array
    covariances: Array
    innovations: Array
    nis: Array
    log_likelihood: Array
    diverged: bool
    extras: Mapping[str, Any] = field(default_factory=dict)
    recording: Any = None
    parameters: Any = None

    def __repr__(self) -> str:
        steps, n = self.states.shape
        span = float(self.time[-1] - self.time[0])
        return (
            f"<{type(self).__name__}: {steps} steps over {span:.6g} s, {n} states, {self.health}>"
        )

    @property
    def health(self) -> str:
        """In words whether it can be believed: "sound", or what is wrong.

        "lost": see `diverged`. "correlated": the innovations of some components are no white noise
        (`navgym.metrics.whiteness`), so that the filter may take noise for motion and its covariance be
        far too small, without NIS showing it.
        """
        if self.diverged:
            return "lost: the filter has failed or has lost the track"
        found = whiteness(self.innovations)
        if not found.correlated.any():
            return "sound"
        told = [
            f"component {i} (lag 1: {found.lag[i]:+.2f}, blocks: {found.block[i]:.1f})"
            for i in np.flatnonzero(found.correlated)
        ]
        return f"correlated: innovations of {', '.join(told)}; the covariance may be far too small"

    @classmethod
    def of(cls, run: Run, time: Array, **more: Any) -> Self:
        """The estimate of a run's only recording; `more` are fields of a kind of estimate."""
        return cls(
            time=time,
            states=run.states[0],
            covariances=run.covariances[0],
            innovations=run.innovations[0],
            nis=run.nis[0],
            log_likelihood=run.log_likelihood[0],
            diverged=bool(run.diverged[0]),
            extras={name: each[0] for name, each in run.extras.items()},
            **more,
        )

    # ---- what others read, and what people look at

    @property
    def columns(self) -> dict[str, Array]:
        """What `to_csv` writes, (T,) each by name: time, states, their standard deviations, NIS, likelihood."""
        names = state_names(self.recording, self.states.shape[1])
        deviations = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        found = {"time": self.time} | dict(zip(names, self.states.T, strict=True))
        found |= {f"sd_{n}": d for n, d in zip(names, deviations.T, strict=True)}
        return found | {"nis": self.nis, "log_likelihood": self.log_likelihood}

    @property
    def pose(self) -> tuple[Array, Array]:
        """Position (T, 3), m, and attitude (T, 4), quaternions, scalar last, as far as the states hold them."""
        place = list(getattr(getattr(self.recording, "model", None), "position", (0, 2)))[:3]
        position = np.zeros((len(self.time), 3))
        position[:, : len(place)] = self.states[:, place]
        return position, np.tile([0.0, 0.0, 0.0, 1.0], (len(self.time), 1))

    @property
    def places(self) -> Array:
        """(T, 3) latitude and longitude, °, and height, m; ValueError where the recording has no origin."""
        meta = getattr(self.recording, "meta", {})
        if meta.get("origin") is None:
            raise ValueError(
                "the estimate has no place on the Earth: read the log from latitude and longitude, or with origin=."
            )
        position, _ = self.pose
        latitude, longitude = load("navgym.auv.geodesy:from_plane")(*position.T[:2], meta["origin"])
        return np.stack([latitude, longitude, np.full(len(latitude), meta["origin"][2])], axis=-1)

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write `columns` as a text file, atomically; returns the path."""
        return write_table(path, {name: values.tolist() for name, values in self.columns.items()})

    def to_tum(self, path: str | os.PathLike[str]) -> Path:
        """Write poses as evo and PlotJuggler read them, a row of `time x y z qx qy qz qw` per step; returns the path.

        Axes are the estimate's own: north, east, down. Attitude is the identity where no state holds it, positions are
        zero on a deck. Steps after a failure are left out.
        """
        return exports.to_tum(self, Path(path))

    def to_geojson(self, path: str | os.PathLike[str]) -> Path:
        """Write the track as GeoJSON, times and deviations beside it; ValueError without an origin."""
        return exports.to_geojson(self, Path(path))

    def to_gpx(self, path: str | os.PathLike[str]) -> Path:
        """Write the track as GPX 1.1, with dates where the log has them; ValueError without an origin."""
        return exports.to_gpx(self, Path(path))

    def plot(self, path: str | os.PathLike[str] | None = None) -> Any:
        """Draw the track with ellipses, errors where the truth is known, innovations, NIS and parameters over time.

        Args:
            path: of a picture to write, such as estimate.png; None: nothing is written.

        Returns a `matplotlib.figure.Figure`. Needs matplotlib: pip install 'navgym[render]'.
        """
        return load("navgym.plotting:plot")(self, None if path is None else Path(path))


def state_names(recording: Any, count: int) -> list[str]:
    """Names of states: px, vx, py, vy, ... where the recording's model says which they are, else x1, x2, ..."""
    names = [f"x{i + 1}" for i in range(count)]
    model = getattr(recording, "model", None)
    for what in ("position", "velocity"):
        for index, axis in zip(getattr(model, what, ()), "xyz", strict=False):
            names[index] = f"{what[0]}{axis}"
    return names


def filters() -> dict[str, str]:
    """Every filter's name and one line on it; of several problems' filters of a name, on each."""
    told = [(n, p.title, f.summary) for p in problems() for n, f in p.filters.items()]
    names = [name for name, _, _ in told]
    found: dict[str, str] = {}
    for name, title, summary in told:
        text = summary if names.count(name) == 1 else f"{title}: {summary}"
        found[name] = f"{found[name]}; {text}" if name in found else text
    return found


def parameter_space(filter_name: str, problem: Any = None) -> ParameterSpace:
    """What can be tuned in a filter.

    Args:
        filter_name: a name of `navgym.filters()`.
        problem: whose filter, where several have one of that name: an "oracle"; its name, the
            `Problem`, or a recording, whose sensors' noise scales then stand in the space as well.

    Raises ValueError for an unknown name, or one that leaves open which filter is meant.
    """
    if problem is None:
        having = problems_with(filter_name)
        spaces = {p.filters[filter_name].space.fingerprint for p in having}
        problem = having[0] if len(spaces) == 1 else problem_of(filter_name)
    elif isinstance(problem, str):
        problem = PROBLEMS[one_of("problem", problem, PROBLEMS)]
    elif not isinstance(problem, Problem):
        own = problem_of(problem)
        return own.space(filter_name, own.stack([problem]))
    space: ParameterSpace = problem.find(filter_name).space
    return space


@overload
def estimate(
    filter_name: str,
    recording: Recording,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> Estimate: ...


@overload
def estimate(
    filter_name: str,
    recording: DualIMURecording,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> DeckEstimate: ...


@overload
def estimate(
    filter_name: str,
    recording: Any,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> Any: ...


def estimate(
    filter_name: str,
    recording: Any,
    parameters: Parameters = None,
    decision_interval: int | None = None,
) -> Any:
    """Run one filter over one recording.

    Args:
        filter_name: a name of `navgym.filters()`.
        recording: what was measured: a `Recording`, or a `DualIMURecording` for the deck's filters,
            which return a `DeckEstimate`.
        parameters: a dict of tunables (missing ones at their defaults); its values may be lists
            with one number per decision interval, or the whole may be an array (intervals,
            parameters) in the order of `navgym.parameter_space`: a schedule. Its last row holds
            to the end. A path reads them from a file that `navgym tune` wrote (`navgym.tuned`); a
            warning says where its scales refer to other noise than the recording's model believes.
        decision_interval: samples per row of a schedule: 5 by default, on decks the filter steps
            that make up 1 s.

    Raises:
        ValueError: unknown filter or parameter, a value outside its range, a recording that the
            filter cannot use.
        TypeError: something that is no recording.
    """
    problem, chosen, batch, given = _asked(filter_name, recording, parameters)
    run = problem.run(chosen, batch, given, decision_interval, everything=True)
    return _kept(problem.estimate(chosen, batch, run), recording, given)


@overload
def smooth(
    filter_name: str,
    recording: Recording,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> Estimate: ...


@overload
def smooth(
    filter_name: str,
    recording: DualIMURecording,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> DeckEstimate: ...


@overload
def smooth(
    filter_name: str,
    recording: Any,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> Any: ...


def smooth(
    filter_name: str,
    recording: Any,
    parameters: Parameters = None,
    decision_interval: int | None = None,
) -> Any:
    """What a filter makes of a whole recording: every state by all measurements, later ones as well.

    For what is taken for truth afterwards. By fixed-interval smoothing (Rauch, Tung & Striebel 1965).

    Args:
        filter_name: one that can be smoothed: kf and oracle of linear models; deck_bank, deck_bank_lever
            and oracle of decks; every INS filter.
        recording: as for `estimate`, and so are the others.
        parameters: of the filter.
        decision_interval: samples per row of a schedule.

    Returns what `estimate` does. States and covariances are smoothed, but where the filter has failed on
    its way: then they are its own, NaN from there on. Innovations, NIS, likelihoods and extras are the
    filter's.

    Raises ValueError and TypeError as `estimate`, and ValueError for a filter that cannot be smoothed.
    """
    problem, chosen, batch, given = _asked(filter_name, recording, parameters)
    run = problem.smooth(chosen, batch, given, decision_interval)
    return _kept(problem.estimate(chosen, batch, run), recording, given)


def _kept(found: Any, recording: Any, given: Any) -> Any:
    """An estimate with what it was made of, where it is of ours."""
    if not isinstance(found, Estimate):
        return found
    return replace(found, recording=recording, parameters=given)


def _asked(
    filter_name: str, recording: Any, parameters: Parameters
) -> tuple[Problem, Filter, Any, Any]:
    """Problem, filter, batch of the one recording and parameters that are meant."""
    problem = problem_of(recording) if not isinstance(recording, str) else None
    if problem is None or not isinstance(recording, problem.recording):
        raise TypeError(f"a recording must be a navgym.Recording, got {type(recording)}.")
    chosen = problem.find(filter_name)
    batch = problem.stack([recording])
    return problem, chosen, batch, settled(parameters, chosen.name, lambda: problem.noises(batch))
