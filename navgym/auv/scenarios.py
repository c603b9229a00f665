"""AUV scenarios: what happens to the vehicle, its sensors and its link.

Regimes and headroom: docs/science/qivbf.md#scenarios-and-headroom.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.core.checks import one_of, positive_int, span, within
from navgym.statespace.models import LinearModel
from navgym.statespace.recording import Model
from navgym.statespace.turn_model import CoordinatedTurnModel


@dataclass(frozen=True)
class Loss:
    """Which samples get lost: independently, in bursts (Gilbert-Elliott), and in planned outages.

    Args:
        rate: long-run share of lost samples, 0 to 1 (planned outages come on top).
        length: mean length of a burst in samples; None for independent losses.
        outages: number of planned outages, spread evenly over the recording.
        outage_length: samples per planned outage.
        per_component: whether each measurement component is lost independently of the others.
    """

    rate: float = 0.0
    length: float | None = None
    outages: int = 0
    outage_length: int = 30
    per_component: bool = False

    def __post_init__(self) -> None:
        within("loss rate", self.rate, 0.0, 1.0)
        if self.length is not None:
            least = max(1.0, self.rate / max(1 - self.rate, 1e-9))
            if within("loss length", self.length, 1.0) < least * (1.0 - 1e-9):
                raise ValueError(
                    f"loss length must be at least rate/(1-rate) = {least:g} samples, got "
                    f"{self.length}: between bursts at least one sample gets through."
                )
        positive_int("outages", self.outages, least=0)
        positive_int("outage_length", self.outage_length)

    @property
    def transition(self) -> tuple[float, float]:
        """Probability that a sample is lost after a received one, and after a lost one."""
        if self.length is None or self.rate in (0.0, 1.0):
            return self.rate, self.rate
        stay = 1.0 - 1.0 / self.length
        return (1.0 - stay) * self.rate / (1.0 - self.rate), stay


@dataclass(frozen=True)
class Regime:
    """Conditions that hold for a while; scales multiply the covariances of the filter's model.

    Args:
        name: shown in plots and tables.
        measurement_scale: true R over the model's R.
        process_scale: true Q over the model's Q.
        outlier_rate: probability that a sample's R is `outlier_scale` times larger still.
        outlier_scale: that factor.
        degrees: degrees of freedom of Student-t measurement noise; None for Gaussian noise.
        loss: the losses of this regime, as for a scenario; None for the scenario's own.
    """

    name: str = "nominal"
    measurement_scale: float = 1.0
    process_scale: float = 1.0
    outlier_rate: float = 0.0
    outlier_scale: float = 100.0
    degrees: float | None = None
    loss: Loss | float | None = None

    def __post_init__(self) -> None:
        for name in ("measurement_scale", "process_scale", "outlier_scale"):
            within(f"{name} of regime {self.name!r}", getattr(self, name), 0.0, above=True)
        within(f"outlier_rate of regime {self.name!r}", self.outlier_rate, 0.0, 1.0)
        if self.degrees is not None:
            within(f"degrees of regime {self.name!r}", self.degrees, 0.0, above=True)
        if self.loss is not None and not isinstance(self.loss, Loss):
            object.__setattr__(self, "loss", Loss(self.loss))


@dataclass(frozen=True)
class Turns:
    """Coordinated turns that the filter's model knows nothing of, between straight legs.

    Args:
        rate: least and largest turn rate, degrees per second, to either side.
        dwell: least and largest duration of a turn or a leg, s; rounded to samples.
    """

    rate: tuple[float, float] = (3.0, 9.0)
    dwell: tuple[float, float] = (20, 60)

    def __post_init__(self) -> None:
        span("rate of turns", self.rate, 0.0)
        span("dwell of turns", self.dwell, 0.0, above=True)


@dataclass(frozen=True)
class AUVScenario:
    """One member of the catalogue; every field can be overridden (`navgym.simulate(..., loss=.5)`).

    Args:
        name: its name without the "auv/" in front.
        summary: one line for listings.
        steps: samples per recording.
        dt: s between samples.
        measured: "all", "position" or "velocity" components of [Px, Vx, Py, Vy]; "beacon" for
            range, bearing, speed and heading under the CoordinatedTurnModel.
        loss: a `Loss`, or a number for independent losses at that rate.
        regimes: the conditions that follow one another, the next drawn uniformly among the others.
        dwell: least and largest number of samples spent in a regime.
        turns: unmodelled turns, or None.
        sway: amplitude (m/s²) and period (s) of a sine that pushes each axis in a phase of its own, and
            that no model knows of; None for none.
        memory: correlation of measurement noise from one sample to the next, 0 to below 1; its size
            stays.
        measurement_scale: multiplies every regime's measurement scale.
        process_scale: multiplies every regime's process scale.
        outlier_scale: replaces every regime's outlier scale, unless None.
        manoeuvre_scale: replaces the process scale of every regime where it is above 1, unless None.
        reference: QIVBF parameters that are best fixed ones here (the environment's zero line).
    """

    name: str
    summary: str
    steps: int = 500
    dt: float = 1.0
    measured: str = "all"
    loss: Loss | float = Loss(0.3)
    regimes: tuple[Regime, ...] = (Regime(),)
    dwell: tuple[int, int] = (50, 150)
    turns: Turns | None = None
    sway: tuple[float, float] | None = None
    memory: float = 0.0
    measurement_scale: float = 1.0
    process_scale: float = 1.0
    outlier_scale: float | None = None
    manoeuvre_scale: float | None = None
    reference: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}), hash=False)

    def __post_init__(self) -> None:
        positive_int("steps", self.steps)
        one_of("measured", self.measured, ("all", "position", "velocity", "beacon"))
        if self.measured == "beacon" and self.turns is not None:
            raise ValueError(
                f"turns={self.turns} are what a linear model knows nothing of, and "
                'measured="beacon" brings a model that turns: leave one of them out.'
            )
        within("dt", self.dt, 0.0, above=True)
        self._check_unmodelled()
        if not isinstance(self.loss, Loss):
            object.__setattr__(self, "loss", Loss(self.loss))
        if not self.regimes or not all(isinstance(r, Regime) for r in self.regimes):
            raise ValueError(
                f"regimes must be a tuple of at least one Regime, got {self.regimes!r}."
            )
        span("dwell", self.dwell, 1, whole=True)
        for name in ("measurement_scale", "process_scale", "outlier_scale", "manoeuvre_scale"):
            if getattr(self, name) is not None:
                within(name, getattr(self, name), 0.0, above=True)
        object.__setattr__(self, "reference", MappingProxyType(dict(self.reference)))

    def _check_unmodelled(self) -> None:
        """ValueError for a sway or a memory that cannot be."""
        within("memory", self.memory, 0.0, 0.999)
        if self.sway is None:
            return
        if self.measured == "beacon" or len(self.sway) != 2:
            raise ValueError(
                f"sway must be an amplitude (m/s²) and a period (s) for a vehicle with a linear model, got "
                f'{self.sway!r} with measured="{self.measured}".'
            )
        for name, value in zip(("amplitude", "period"), self.sway, strict=True):
            within(f"{name} of sway", value, 0.0, above=True)

    def __reduce__(self) -> tuple[Any, ...]:
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        values["reference"] = dict(self.reference)
        return _rebuild, (values,)

    def override(self, **fields: Any) -> AUVScenario:
        """The same scenario with some fields changed; ValueError for an unknown field."""
        known = [f.name for f in dataclasses.fields(self)]
        for name in fields:
            one_of("scenario field", name, known)
        return dataclasses.replace(self, **fields) if fields else self

    @property
    def model(self) -> Model:
        """The model that filters are given: QIVBF table 2 with the scenario's `dt` and `measured`."""
        return _model(self.dt, self.measured)


@functools.lru_cache(maxsize=64)
def _model(dt: float, measured: str) -> Model:
    if measured == "beacon":
        return CoordinatedTurnModel(dt=dt)
    rows = {"all": [0, 1, 2, 3], "position": [0, 2], "velocity": [1, 3]}[measured]
    return LinearModel(dt=dt, H=np.eye(4)[rows])


def _rebuild(values: dict[str, Any]) -> AUVScenario:
    return AUVScenario(**values)


CALM = Regime("calm", measurement_scale=0.25)
NOMINAL = Regime("nominal")
NOISY = Regime("noisy", measurement_scale=25.0)
OUTLIER = Regime("outlier", outlier_rate=0.2)
BURST = Regime("burst", loss=Loss(0.6, length=10))
MANOEUVRE = Regime("manoeuvre", process_scale=100.0)

# QIVBF's best fixed parameters in each scenario, from `python scripts/choose_defaults.py references`:
# prior_count, forgetting, initial_count, initial_scale, process_noise_scale (5 sweeps, no fill).
_BEST_FIXED: Mapping[str, tuple[float, float, float, float, float]] = {
    "nominal": (300, 0.999, 100, 1, 1),
    "paper": (270, 0.9972, 99, 1.3, 1.4),
    "burst": (40, 0.9976, 69, 0.13, 0.47),
    "outage": (180, 0.9969, 83, 1.3, 1),
    "tvr": (210, 0.9972, 82, 12, 1),
    "heavy": (5, 0.84, 10, 1.7, 4.6),
    "student": (120, 0.929, 47, 1.1, 2.3),
    "mismatch": (170, 0.997, 98, 1, 100),
    "turn": (7.5, 0.9987, 97, 1.8, 180),
    "position-only": (300, 0.999, 100, 1, 1),
    "component-loss": (290, 0.999, 98, 1.1, 1.1),
    "switch-A": (180, 0.89, 53, 7.2, 2.9),
    "switch-B": (1.5, 0.906, 7, 9.4, 14),
    "switch-D": (2, 0.85, 5, 1, 70),
}


def _reference(name: str) -> dict[str, Any]:
    """Parameters of the reference filter in scenario `name`; none where QIVBF cannot run."""
    if name not in _BEST_FIXED:
        return {}
    names = ("prior_count", "forgetting", "initial_count", "initial_scale", "process_noise_scale")
    values = dict(zip(names, _BEST_FIXED[name], strict=True))
    return {"vb_iterations": 5, "fill": "skip"} | values


def _catalogue() -> dict[str, AUVScenario]:
    switching: dict[str, Any] = {"steps": 800, "loss": Loss(0.0), "dwell": (50, 150)}
    members = [
        AUVScenario("nominal", "model exact, 30 % independent loss: nothing beats predict-only"),
        AUVScenario("paper", "the setting of QIVBF section 5, with 30 % independent loss", steps=100),
        AUVScenario("burst", "losses in bursts of 20 samples on average", loss=Loss(0.3, length=20)),
        AUVScenario("outage", "three planned outages of 30 samples", loss=Loss(0.0, outages=3)),
        AUVScenario(
            "tvr", "R switches between .25 and 25 times nominal", dwell=(75, 125),
            regimes=(CALM, NOISY),
        ),
        AUVScenario("heavy", "10 % outliers of 100 times R", regimes=(Regime("heavy", outlier_rate=0.1),)),
        AUVScenario("student", "Student-t noise with 3 degrees", regimes=(Regime("student", degrees=3.0),)),
        AUVScenario("mismatch", "the vehicle manoeuvres: true Q is 100 times the model's", regimes=(MANOEUVRE,)),
        AUVScenario("turn", "unmodelled coordinated turns", turns=Turns()),
        AUVScenario(
            "coordinated-turn", "range, bearing, speed and heading from a beacon; the model turns",
            measured="beacon",
        ),
        AUVScenario("position-only", "no velocity is measured", measured="position"),
        AUVScenario("component-loss", "each component is lost on its own", loss=Loss(0.3, per_component=True)),
        AUVScenario(
            "switch-A", "calm, noisy, outlier and burst follow one another",
            regimes=(CALM, NOISY, OUTLIER, BURST), **switching,
        ),
        AUVScenario(
            "switch-B", "calm, noisy, outlier, burst and manoeuvre follow one another",
            regimes=(CALM, NOISY, OUTLIER, BURST, MANOEUVRE), **switching,
        ),
        AUVScenario(
            "switch-D", "nominal, outlier and manoeuvre follow one another",
            regimes=(NOMINAL, OUTLIER, MANOEUVRE), **switching,
        ),
    ]  # fmt: skip
    return {s.name: s.override(reference=_reference(s.name)) for s in members}


CATALOGUE: Mapping[str, AUVScenario] = MappingProxyType(_catalogue())

# Conditions that a filter or a policy was not tuned on, overrides by name:
# docs/science/qivbf.md#what-agents-reach, docs/science/qivbf.md#bank-and-combiner.
SHIFTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "loss .3": {"loss": 0.3},
        "loss .7": {"loss": 0.7},
        "R x3": {"measurement_scale": 3.0},
        "R x10": {"measurement_scale": 10.0},
        "R /3": {"measurement_scale": 1.0 / 3.0},
        "Q x3": {"process_scale": 3.0},
        "R and Q x3": {"measurement_scale": 3.0, "process_scale": 3.0},
        "dwell 20-60": {"dwell": (20, 60)},
        "dwell 150-300": {"dwell": (150, 300)},
        "outliers x50": {"outlier_scale": 50.0},
        "outliers x200": {"outlier_scale": 200.0},
        "manoeuvre Q x300": {"manoeuvre_scale": 300.0},
    }
)
