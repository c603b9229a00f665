"""A learned combiner on the frozen bank: kept as npz and JSON, run by a compiled kernel, no torch.

    combiner = Combiner.load("agents/pretrained/combiner")
    estimate = combiner.estimate(recording)

See `navgym.statespace.filters.combiner` for what it computes and `navgym.agents.combiner.training` for how it is made.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.policies import portable
from navgym.core.checks import Array, real_array, shaped
from navgym.core.frozen import Frozen
from navgym.core.parameters import ParameterSpace, parameter_table
from navgym.core.storage import writable
from navgym.estimation import Estimate
from navgym.problem import Problem, Run
from navgym.statespace import run as statespace
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import combiner as kernels
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.filters.modes import MODE_SETS, ModeSet
from navgym.statespace.recording import Recording

KIND = "navgym combiner"
BANK = "bank"  # the filter that it stands on


@dataclass(frozen=True, eq=False)
class Combiner(Frozen):
    """Weighs the modes of a frozen `bank` anew after each sample, by what it has learned.

    A combiner is causal, runs each recording alike in any batch, and never changes the bank.

    Args:
        shift: (D,) subtracted from the inputs, `navgym.statespace.filters.combiner.input_names`.
        gain: (D,) multiplies them then.
        W: (D, 3 H) weights of the inputs; columns: reset, update, candidate of H units.
        b: (3 H,) their biases.
        U: (H, 3 H) weights of the units before.
        c: (3 H,) their biases.
        V: (H, A + B) weights of the outputs: a log-weight per node and per regime.
        d: (A + B,) their biases.
        bank: modes and parameters of the bank that it was trained on, see `bank_facts`; those of
            this navgym by default.
        training: command, configuration, seeds, scores; whatever JSON can hold.

    Raises:
        ValueError: arrays that do not fit or are no numbers, or another bank than this navgym's.
    """

    shift: Array
    gain: Array
    W: Array
    b: Array
    U: Array
    c: Array
    V: Array
    d: Array
    bank: Mapping[str, Any] | None = None
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        arrays = {name: _single(name, getattr(self, name)) for name in kernels.ARRAYS}
        units = len(arrays["U"]) if arrays["U"].ndim == 2 else 0
        if units == 0:
            raise ValueError(f"U must have shape (H, 3 H) with H units, got {arrays['U'].shape}.")
        for name, shape in kernels.shapes(modes(), units).items():
            shaped(name, arrays[name], shape, f"{units} units on the modes of {BANK!r}")
        facts = bank_facts()
        if self.bank is not None and dict(self.bank) != facts:
            changed = [name for name in facts if self.bank.get(name) != facts[name]]
            raise ValueError(
                f"the combiner was trained on a {BANK} that differs from this navgym's in "
                f"{', '.join(changed) or 'unknown fields'}: train it again "
                "(navgym combine), or install the navgym that made it."
            )
        self._freeze(arrays | {"bank": facts, "training": writable(self.training)})

    # ---- running -----------------------------------------------------------------------------

    def estimate(self, recording: Recording, fallback: bool = False) -> Estimate:
        """Run over one recording.

        Innovations, NIS and log-likelihood are the bank's own; `extras["weights"]` holds the new
        weights of the modes (T, J).

        Args:
            recording: with the default model's size: 4 states, 4 measurements.
            fallback: for another size, return what the bank says on its own instead of raising.

        Raises:
            ValueError: a recording of a size that it was not trained for.
        """
        batch = StateSpaceBatch.of([recording])
        found = self.run(batch, everything=True, fallback=fallback)
        kept = {"weights": found.extras["weights"]}
        return Estimate.of(replace(found, extras=kept), batch.time_of(0))

    def run(self, batch: StateSpaceBatch, everything: bool = False, fallback: bool = False) -> Run:
        """Run over a batch; extras hold `weights`.

        Args:
            batch: stacked recordings with 4 states and 4 measurements.
            everything: False computes `states` and `diverged` only.
            fallback: see `estimate`.

        Raises:
            ValueError: recordings of a size that it was not trained for.
        """
        if not kernels.fits(batch):
            if fallback:
                chosen, own = CATALOGUE[BANK], self._parameters
                table = parameter_table(chosen.space, own, len(batch), batch.steps, 1)
                return statespace.run(chosen, batch, table, 1, everything)
            size = f"{batch.models.dtype['x0'].shape[0]} and {batch.y.shape[2]}"
            raise ValueError(
                f"the combiner was trained for {kernels.STATES} states and {kernels.MEASURED} "
                f"measurements under a LinearModel, not for {size}: use "
                f'navgym.estimate("{BANK}", recording), or pass fallback=True, which does.'
            )
        found = kernels.estimate(self._network, modes(), batch, self._table, everything)
        return statespace.as_run(found, batch, everything)

    @property
    def _parameters(self) -> Mapping[str, Any]:
        assert self.bank is not None
        parameters: Mapping[str, Any] = self.bank["parameters"]
        return parameters

    @property
    def _table(self) -> Array:
        return space().array(self._parameters)[None]

    @property
    def _network(self) -> NDArray[Any]:
        return kernels.pack(modes(), {name: getattr(self, name) for name in kernels.ARRAYS})

    # ---- files -------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write NAME.npz and NAME.json, each whole or not at all; returns the path of the npz.

        Raises FileNotFoundError if the folder does not exist.
        """
        arrays = {name: getattr(self, name).astype(np.float32) for name in kernels.ARRAYS}
        return portable.write(path, KIND, arrays, {"bank": self.bank, "training": self.training})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Combiner:
        """Read what `save` wrote: NAME, with or without ".npz".

        Raises:
            FileNotFoundError: one of the two files is missing.
            ValueError: truncated or foreign files, weights that are no numbers or do not fit, files
                that do not belong together, another bank.
        """
        header, arrays = portable.read(path, KIND, ("bank", "training"))
        file = portable.pair(path)[0]
        missing = [name for name in kernels.ARRAYS if name not in arrays]
        if missing:
            raise ValueError(f"{file} is damaged: it lacks {missing[0]!r}. Save it again.")
        try:
            own = {name: arrays[name] for name in kernels.ARRAYS}
            return cls(**own, bank=dict(header["bank"]), training=dict(header["training"]))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{file}: {error}") from error


def _single(field: str, value: Any) -> Array:
    """`value` as numbers that survive being kept in single precision; ValueError naming the field."""
    with np.errstate(over="ignore"):
        kept = real_array(field, value).astype(np.float32)
    return real_array(field, kept)


def combines(problem: Problem) -> bool:
    """Whether a problem has the bank that combiners stand on."""
    return problem.filters.get(BANK) is CATALOGUE[BANK]


def space() -> ParameterSpace:
    """The bank's parameters."""
    return CATALOGUE[BANK].space


def modes() -> ModeSet:
    """The bank's modes."""
    return MODE_SETS[BANK]


def bank_facts() -> dict[str, Any]:
    """What a network relies on: the bank's modes and parameters, what is read of it, and how."""
    own = modes()
    return writable(
        {
            "modes": dataclasses.asdict(own),
            "parameters": space().defaults,
            "inputs": kernels.input_names(own),
            "constants": {"bound": kernels.BOUND, "clip": kernels.CLIP, "floor": kernels.FLOOR},
        }
    )
