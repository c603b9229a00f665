"""Train a combiner: supervised, on recordings under conditions drawn anew for each.

A training can be stopped at any time, also by SIGKILL: the same call goes on from its last
checkpoint, and ends with the network that an uninterrupted one ends with.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from navgym.agents.combiner.combiner import Combiner, bank_facts, modes
from navgym.agents.combiner.material import (
    AT_ONCE,
    CombinerConfiguration,
    Lessons,
    Single,
    checked_memory,
    material,
)
from navgym.agents.training import checkpoints
from navgym.agents.training.checkpoints import Checkpoint, Report
from navgym.agents.training.record import versions
from navgym.core.atomic import writable_folder
from navgym.core.checks import Array
from navgym.core.seeds import seeds
from navgym.core.streams import say
from navgym.statespace.filters import combiner as kernels

if TYPE_CHECKING:
    import torch


RANDOMISED, OTHERS = "randomised", "others"
WARM_UP = 20  # updates over which the step size grows to its full size
LIMIT = 0.1  # of the gradient's norm


# ---- the network in torch ----------------------------------------------------------------------


class Network:
    """The combiner's network for training, equal to the kernel's up to rounding.

    Args:
        units: of the recurrent layer.
        shift: (D,) see `Combiner`.
        gain: (D,).
    """

    def __init__(self, units: int, shift: Array, gain: Array) -> None:
        import torch
        from torch import nn

        self.shift, self.gain = (torch.from_numpy(a.astype(np.float32)) for a in (shift, gain))
        own = kernels.modes_of(modes())
        self.node, self.regime = torch.from_numpy(own.node), torch.from_numpy(own.regime)
        self.nodes, self.moved = len(own.prior), sum(kernels.moved_by(modes()))
        self.layers = nn.ModuleDict(
            {
                "gru": nn.GRU(len(shift), units, batch_first=True),
                "out": nn.Linear(units, self.moved),
            }
        )
        for parameter in self.layers["out"].parameters():
            nn.init.zeros_(parameter)

    @classmethod
    def for_inputs(cls, units: int, inputs: Single) -> Network:
        """One that brings `inputs` (N, T, D) to zero mean and unit variance."""
        flat = inputs.reshape(-1, inputs.shape[-1])
        mean, deviation = flat.mean(axis=0, dtype=np.float64), flat.std(axis=0, dtype=np.float64)
        return cls(units, mean, 1.0 / np.maximum(deviation, 1e-3))

    def __call__(
        self, inputs: torch.Tensor, h: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Log-weights (N, T, J) to add, and the hidden state, for inputs (N, T, D)."""
        import torch

        u = ((inputs - self.shift) * self.gain).clamp(-kernels.CLIP, kernels.CLIP)
        hidden, h = self.layers["gru"](u, h)
        assert h is not None
        a = kernels.BOUND * torch.tanh(self.layers["out"](hidden) / kernels.BOUND)
        return a[..., self.node] + a[..., self.nodes + self.regime], h

    def combiner(self, training: Mapping[str, Any]) -> Combiner:
        """The portable combiner of this network."""
        gru, out = self.layers["gru"], self.layers["out"]
        tensors: dict[str, Any] = {
            "shift": self.shift, "gain": self.gain, "W": gru.weight_ih_l0.T, "b": gru.bias_ih_l0,
            "U": gru.weight_hh_l0.T, "c": gru.bias_hh_l0, "V": out.weight.T, "d": out.bias,
        }  # fmt: skip
        arrays = {name: tensor.detach().numpy() for name, tensor in tensors.items()}
        return Combiner(**arrays, bank=bank_facts(), training=training)


def mixed(log_weights: torch.Tensor, offsets: torch.Tensor) -> torch.Tensor:
    """Offset (..., 2) of the mixture under log-weights (..., J) of modes with offsets (..., J, 2)."""
    weights = log_weights.softmax(-1)
    return (weights[..., None] * offsets).sum(-2)


def gains(network: Network, of: Lessons) -> Array:
    """Relative reduction of each recording's position RMSE against the bank, (N,)."""
    import torch

    found = []
    with torch.no_grad():
        for i in range(0, len(of.scale), AT_ONCE):
            rows = slice(i, i + AT_ONCE)
            inputs, log_weights, offsets, scatter = (
                torch.from_numpy(a[rows])
                for a in (of.inputs, of.log_weights, of.offsets, of.scatter)
            )
            moved, _ = network(inputs)
            errors = mixed(log_weights + moved, offsets) + scatter
            found.append((errors**2).sum(-1).mean(1).numpy() / of.scale[rows])
    return np.asarray(1.0 - np.sqrt(np.concatenate(found)), dtype=np.float64)


# ---- training ------------------------------------------------------------------------------------


def train(
    config: CombinerConfiguration, fresh: bool = False, report: Report = say, command: str = ""
) -> Combiner:
    """Train as `config` says, or go on with what is in its folder; returns the best network.

    Args:
        config: see `CombinerConfiguration`.
        fresh: start anew, whatever the folder holds.
        report: takes lines of progress.
        command: that reproduces this, for the manifest.

    Raises:
        ValueError: the folder holds another training; recordings that take too much memory.
    """
    writable_folder("out", config.folder)
    checked_memory(config)
    kept = None
    if fresh:
        checkpoints.clear(config.folder / "checkpoints")
    else:
        kept = checkpoints.to_continue(config.folder, _comparable(config), report)
    trainer = Trainer(config, report, command)
    if kept is not None:
        with checkpoints.fitting(config.folder):
            trainer.take_up(kept)
    trainer.run()
    return trainer.finish()


def _comparable(config: CombinerConfiguration) -> dict[str, Any]:
    """What a checkpoint must agree on to be gone on from: the configuration, and the bank."""
    return config.comparable() | {"bank": bank_facts()}


class Trainer:
    """Material, network, optimiser and what they made so far.

    Args:
        config: what to do.
        report: takes lines of progress.
        command: that reproduces this.
    """

    def __init__(self, config: CombinerConfiguration, report: Report, command: str = "") -> None:
        import torch

        self.config, self.report, self.command = config, report, command
        torch.set_num_threads(config.threads)
        began = time.perf_counter()
        self.material = material(config.for_training())
        self.arenas = _arenas(config)
        torch.manual_seed(config.seed)
        self.network = Network.for_inputs(config.units, self.material.inputs)
        parameters = self.network.layers.parameters()
        self.optimiser = torch.optim.Adam(parameters, lr=config.learning_rate)
        self.done = 0  # rounds
        self.best: dict[str, Any] = {"score": -math.inf}
        self.best_layers: Any = None
        self._began = time.perf_counter()
        report(
            f"made {config.recordings} training recordings ({self.material.gigabytes:.2f} GB) in "
            f"{self._began - began:.0f} s"
        )

    def run(self) -> None:
        """Train until the configuration's number of rounds, validating at intervals."""
        if self.best_layers is None:
            self.look()
        while self.done < self.config.rounds:
            self._round()
            self.done += 1
            if self.done % self.config.interval == 0 or self.done == self.config.rounds:
                self.look()

    def _round(self) -> None:
        """Read a batch of recordings from end to end, with an update after each chunk."""
        import torch

        config, of = self.config, self.material
        rng = np.random.default_rng([config.seed, self.done])
        rows = np.sort(rng.choice(config.recordings, config.batch, replace=False))
        steps, scale = of.inputs.shape[1], torch.from_numpy(of.scale[rows])[:, None]
        h = None
        for first in range(0, steps, config.chunk):
            self._set_rate((self.done + first / steps) / config.rounds)
            inputs, log_weights, offsets = (
                torch.from_numpy(a[rows, first : first + config.chunk])
                for a in (of.inputs, of.log_weights, of.offsets)
            )
            moved, h = self.network(inputs, h)
            h = h.detach()
            excess = (mixed(log_weights + moved, offsets) ** 2).sum(-1)
            self.optimiser.zero_grad()
            (excess / scale).mean().backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(self.network.layers.parameters(), LIMIT)
            self.optimiser.step()

    def _set_rate(self, progress: float) -> None:
        """Step size at `progress` (0 to 1)."""
        updates = progress * self.config.rounds * self._updates + 1
        cosine = 0.5 * (1.0 + math.cos(math.pi * progress))
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.learning_rate * cosine * min(1.0, updates / WARM_UP)

    @property
    def _updates(self) -> int:
        """Updates per round."""
        return math.ceil(int(self.material.inputs.shape[1]) / self.config.chunk)

    # ---- validation and checkpoints ----------------------------------------------------------

    def look(self) -> None:
        """Validate the network as it is, keep it if it is the best, write a checkpoint."""
        found = {name: float(gains(self.network, of).mean()) for name, of in self.arenas.items()}
        score = sum(found.values()) / len(found)
        if score > self.best["score"]:
            self.best = {"score": score, "round": self.done, "gains": found}
            self.best_layers = checkpoints.packed(self.network.layers.state_dict())
        self._save()
        seconds = time.perf_counter() - self._began
        each = ", ".join(f"{name} {100 * gain:+.2f} %" for name, gain in found.items())
        self.report(
            f"{self.done / self.config.rounds:4.0%}  {self.done} rounds, {seconds:.0f} s, against "
            f"the bank: {each}, best after {self.best['round']}"
        )

    def _save(self) -> None:
        arrays = {
            "layers": checkpoints.packed(self.network.layers.state_dict()),
            "optimiser": checkpoints.packed(self.optimiser.state_dict()),
            "best": self.best_layers,
        }
        facts = {
            "configuration": _comparable(self.config), "done": self.done, "best": self.best,
        }  # fmt: skip
        checkpoints.save(self.config.folder / "checkpoints", self.done, Checkpoint(arrays, facts))

    def take_up(self, kept: Checkpoint) -> None:
        """Go on where a checkpoint was written."""
        self.network.layers.load_state_dict(checkpoints.unpacked(kept.arrays["layers"]))
        self.optimiser.load_state_dict(checkpoints.unpacked(kept.arrays["optimiser"]))
        self.best_layers = kept.arrays["best"]
        self.best, self.done = dict(kept.facts["best"]), int(kept.facts["done"])
        self.report(f"going on after round {self.done}")

    def finish(self) -> Combiner:
        """Write the best network as a combiner, and return it."""
        self.network.layers.load_state_dict(checkpoints.unpacked(self.best_layers))
        chosen = self.config.training_seeds
        made = self.network.combiner(
            {
                "command": self.command,
                "configuration": self.config.comparable(),
                "seeds": {
                    "train": [chosen.start, chosen.stop - 1], "validation": self.config.validation,
                },
                "validation": self.best,
                "versions": versions(),
            }
        )  # fmt: skip
        made.save(self.config.folder / "combiner")
        return made


def _arenas(config: CombinerConfiguration) -> dict[str, Lessons]:
    """Validation recordings: every scenario as it is, conditions drawn anew, and the others."""
    own = seeds("validation", config.validation)
    found = {name: material(config.simulated((name,), own, 1.0)) for name in config.scenarios}
    further = seeds("validation", config.validation, start=config.validation)
    found[RANDOMISED] = material(config.simulated(config.scenarios, further))
    found[OTHERS] = material(config.simulated(config.others, own, 1.0))
    return found
