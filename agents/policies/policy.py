"""A trained policy as plain arrays: run by numpy alone, kept as npz and JSON, never unpickled."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.agents.policies import portable
from navgym.agents.policies.manifest import ANOTHER, Manifest
from navgym.core.checks import Array, one_of, real_array, shaped, within
from navgym.envs.actions import LIMIT, action_table, fill_rows
from navgym.problem import PROBLEMS
from navgym.tuned import read_tuned

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

KIND = "navgym policy"
PRETRAINED = Path(__file__).parents[1] / "pretrained"  # what comes with navgym
ACTIVATIONS = ("tanh", "relu")

Single = NDArray[np.float32]

# arrays, because numpy takes three times as long for a plain number
_ZERO, _ONE, _MINUS = (np.array(value, np.float32) for value in (0.0, 1.0, -1.0))


@dataclasses.dataclass(frozen=True)
class Normalisation:
    """Observations before the first layer: (o − mean) / √(variance + epsilon), clipped.

    Args:
        mean: (n,).
        variance: (n,).
        clip: largest magnitude afterwards.
        epsilon: keeps the division finite.
    """

    mean: Array
    variance: Array
    clip: float = 10.0
    epsilon: float = 1e-8

    @classmethod
    def none(cls, n: int) -> Normalisation:
        """Of a policy that takes its n observations as they are."""
        return cls(np.zeros(n), np.ones(n), clip=1e30, epsilon=0.0)


class Policy:
    """Observations in, actions in [-1, 1] out: a small network in numpy. Deterministic.

    Args:
        manifest: what it reads, what it sets, where it comes from.
        layers: weights (out, in) and biases (out,), first to last.
        normalisation: of observations; None: none.
        low: (n,) smallest raw observation seen in validation; None: the environment's bound.
        high: (n,) largest one.
        activation: between layers, "tanh" or "relu".
        squash: whether a tanh follows the last layer; else its output is clipped.
        reach: what actions are multiplied by then: the largest that it takes.

    Raises:
        ValueError: for shapes that do not fit the manifest, or weights that are no numbers.
    """

    def __init__(
        self,
        manifest: Manifest,
        layers: Sequence[tuple[ArrayLike, ArrayLike]],
        normalisation: Normalisation | None = None,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
        activation: str = "tanh",
        squash: bool = False,
        reach: float = 1.0,
    ) -> None:
        self.reach = np.float32(within("reach", reach, 0.0, 1.0))
        self.manifest = manifest
        self.activation = one_of("activation", activation, ACTIVATIONS)
        self.squash = bool(squash)
        n = len(manifest.observation_names)
        self.normalisation = _checked(normalisation or Normalisation.none(n), n)
        self.low, self.high = (
            real_array(name, np.full(n, bound) if given is None else given)
            for name, given, bound in (("low", low, -LIMIT), ("high", high, LIMIT))
        )
        for name, bounds in (("low", self.low), ("high", self.high)):
            shaped(name, bounds, (n,), "a bound per observation")
        self.layers = _checked_layers(layers, n, len(manifest.action_parameters))
        self._transposed = [(np.ascontiguousarray(w.T), b) for w, b in self.layers]
        self._scale = np.sqrt(self.normalisation.variance + self.normalisation.epsilon)
        self._clip = np.full(n, float(self.normalisation.clip))
        self._floor = -self._clip
        self._space = manifest.whole_space
        self._row: Array = self._space.array(manifest.reference)
        names, residual = manifest.action_parameters, manifest.settings.get("action") == "residual"
        self._table = action_table(self._space, names, self._row[0], residual)

    def __call__(self, observation: ArrayLike) -> Single:
        """Actions in [-1, 1], (k,) or (N, k), for observations (n,) or (N, n)."""
        x: Any = np.asarray(observation)
        if x.shape[-1:] != self.low.shape or x.ndim > 2:
            raise ValueError(
                f"observation must have shape ({len(self.low)},) or (N, {len(self.low)}), got "
                f"{x.shape}: the policy reads {', '.join(self.manifest.observation_names[:3])}, ..."
            )
        x = x - self.normalisation.mean
        x /= self._scale
        np.maximum(x, self._floor, out=x)
        np.minimum(x, self._clip, out=x)
        x = x.astype(np.float32)
        for weights, bias in self._transposed[:-1]:
            x = np.dot(x, weights)
            x += bias
            self._activate(x)
        weights, bias = self._transposed[-1]
        x = np.dot(x, weights)
        x += bias
        if self.squash:
            np.tanh(x, out=x)
        np.maximum(x, _MINUS, out=x)
        action: Single = np.minimum(x, _ONE, out=x)
        action *= self.reach
        return action

    def _activate(self, x: Single) -> None:
        """The nonlinearity between layers, in place: a call with fresh arrays takes half as long again."""
        if self.activation == "relu":
            np.maximum(x, _ZERO, out=x)
        else:
            np.tanh(x, out=x)

    def parameters(self, observation: ArrayLike) -> Array:
        """The filter's whole physical parameter row, (P,) or (N, P), for those observations.

        Exactly what the environment puts in force on the policy's action. Raises ValueError for an
        observation that is no number.
        """
        action = self(observation)
        single = action.ndim == 1
        actions = action[None] if single else np.ascontiguousarray(action)
        rows = self._row.copy() if single else np.repeat(self._row, len(actions), axis=0)
        if not fill_rows(rows, actions, self._table):  # type: ignore[no-untyped-call]
            raise ValueError(f"observation must be finite, got {np.asarray(observation)}.")
        return rows[0] if single else rows

    def check(self, environment: str, observation_names: Sequence[str], space: str) -> None:
        """Raise ValueError unless the policy is for this environment; see `Manifest.check`."""
        self.manifest.check(environment, observation_names, space)

    # ---- files ------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write NAME.npz and NAME.json, each whole or not at all; returns the path of the npz.

        Args:
            path: NAME, with or without ".npz".

        Raises FileNotFoundError if the folder does not exist.
        """
        header, arrays = self.parts()
        return portable.write(path, KIND, arrays, header)

    def to_onnx(self, path: str | os.PathLike[str]) -> Path:
        """Write an ONNX model of the same function, the manifest in its metadata; returns the path.

        Raises RuntimeError where the extra `navgym[onnx]` is missing.
        """
        from navgym.agents.policies.onnx_model import write_onnx

        return write_onnx(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Policy:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: one of the two files is missing.
            ValueError: a truncated or foreign file, weights that are no numbers or do not fit,
                files that do not belong together, another version of the parameter space.
        """
        wanted = ("architecture", *(f.name for f in dataclasses.fields(Manifest)))
        header, arrays = portable.read(path, KIND, wanted)
        try:
            return cls.of_parts(header, arrays)
        except KeyError as error:
            raise ValueError(f"{portable.pair(path)[0]} is damaged: it lacks {error}.") from error
        except TypeError as error:
            raise ValueError(f"{portable.pair(path)[0]} is damaged: {error}.") from error
        except ValueError as error:
            raise ValueError(f"{portable.pair(path)[0]}: {error}") from error

    @classmethod
    def of_parts(cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Policy:
        """Inverse of `parts`; KeyError, TypeError or ValueError for what does not fit."""
        manifest = Manifest(**{f.name: header[f.name] for f in dataclasses.fields(Manifest)})
        shape = header["architecture"]
        count = len(shape["sizes"]) - 1
        return cls(
            manifest,
            [(arrays[f"weights.{i}"], arrays[f"bias.{i}"]) for i in range(count)],
            Normalisation(arrays["mean"], arrays["variance"], shape["clip"], shape["epsilon"]),
            arrays["low"],
            arrays["high"],
            shape["activation"],
            shape["squash"],
            shape.get("reach", 1.0),
        )

    def parts(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """What `save` writes: facts as JSON holds them, and arrays."""
        arrays: dict[str, NDArray[Any]] = {
            "low": self.low,
            "high": self.high,
            "mean": self.normalisation.mean,
            "variance": self.normalisation.variance,
        }
        for i, (weights, bias) in enumerate(self.layers):
            arrays |= {f"weights.{i}": weights, f"bias.{i}": bias}
        architecture = {
            "sizes": [len(self.low), *(len(b) for _, b in self.layers)],
            "activation": self.activation,
            "squash": self.squash,
            "clip": self.normalisation.clip,
            "epsilon": self.normalisation.epsilon,
        } | ({} if self.reach == 1.0 else {"reach": float(self.reach)})
        return {"architecture": architecture} | dataclasses.asdict(self.manifest), arrays

    # ---- from Stable-Baselines3 ----------------------------------------------------------------

    @classmethod
    def from_sb3(
        cls,
        model: BaseAlgorithm,
        normalisation: VecNormalize | None,
        manifest: Manifest,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
        columns: Sequence[int] | None = None,
        reach: float = 1.0,
    ) -> Policy:
        """What `model.predict(..., deterministic=True)` computes, as a `Policy`.

        Args:
            model: trained by PPO, A2C, SAC, TQC, TD3 or DDPG with a plain `MlpPolicy`.
            normalisation: the `VecNormalize` that it was trained behind, or None.
            manifest: what to write beside it.
            low: (n,) smallest raw observation seen in validation.
            high: (n,) largest one.
            columns: of the observation, that the model reads; all by default. The policy takes whole ones.
            reach: what the environment multiplied the model's actions by.

        Raises:
            ValueError: a network that is more than dense layers.
        """
        layers, activation, squash = dense_layers(model)
        chosen = None
        if normalisation is not None and normalisation.norm_obs:
            rms: Any = normalisation.obs_rms
            chosen = Normalisation(
                rms.mean, rms.var, float(normalisation.clip_obs), float(normalisation.epsilon)
            )
        if columns is not None:
            n = len(manifest.observation_names)
            layers = [(widened(layers[0][0], columns, n), layers[0][1]), *layers[1:]]
            if chosen is not None:
                mean, variance = (
                    widened(a[None], columns, n, fill)[0]
                    for a, fill in ((chosen.mean, 0.0), (chosen.variance, 1.0))
                )
                chosen = dataclasses.replace(chosen, mean=mean, variance=variance)
        return cls(manifest, layers, chosen, low, high, activation, squash, reach)

    def with_training(self, **facts: Any) -> Policy:
        """The same policy, whose manifest says more of its training."""
        training = {**self.manifest.training, **facts}
        return self._again(self.layers, dataclasses.replace(self.manifest, training=training))

    def with_reference(self, reference: Mapping[str, Any] | str | os.PathLike[str]) -> Policy:
        """The same policy around other parameters: its actions start from them, and it falls back to them.

        Made for policies that were trained with `references`; others may be worse than the parameters
        that they are put around, which `navgym evaluate --log` tells. The manifest says what was done.

        Args:
            reference: parameters of the policy's filter, or the path of a tuned.toml.

        Raises ValueError for parameters of another filter, and for a policy whose actions do not start
        from a reference.
        """
        if self.manifest.settings.get("action") != "residual":
            raise ValueError(
                "the policy sets parameters outright, whatever the reference: train one with "
                "action='residual'."
            )
        source = "given"
        if isinstance(reference, (str, os.PathLike)):
            source, tuned = Path(reference).name, read_tuned(reference)
            one_of("filter of the reference", tuned.filter, (self.manifest.filter,))
            reference = tuned.parameters
        whole = self._space.defaults | dict(reference)
        if len(self._space.array(whole)) > 1:
            raise ValueError(f"reference must hold one number per parameter, got {reference!r}.")
        training = {**self.manifest.training, ANOTHER: source}
        settings = {**self.manifest.settings, "reference": whole}
        manifest = dataclasses.replace(
            self.manifest, reference=whole, settings=settings, training=training
        )
        return self._again(self.layers, manifest)

    def silent(self) -> Policy:
        """The policy that always leaves the reference in force: what is written where a guard said no."""
        *before, (weights, bias) = self.layers
        return self._again([*before, (weights * 0.0, bias * 0.0)], self.manifest)

    def _again(self, layers: Sequence[tuple[ArrayLike, ArrayLike]], manifest: Manifest) -> Policy:
        return Policy(
            manifest, layers, self.normalisation, self.low, self.high, self.activation, self.squash,
            float(self.reach),
        )  # fmt: skip


def widened(weights: ArrayLike, columns: Sequence[int], n: int, fill: float = 0.0) -> Array:
    """Weights (out, k) of some `columns` as weights (out, n) of all."""
    given = np.asarray(weights, dtype=np.float64)
    found = np.full((len(given), n), fill)
    found[:, list(columns)] = given
    return found


def dense_layers(model: BaseAlgorithm) -> tuple[list[tuple[Array, Array]], str, bool]:
    """Layers of a model's deterministic actor, their activation, and whether a tanh ends it.

    Raises ValueError for a network that is more than dense layers.
    """
    from torch import nn

    policy: Any = model.policy
    if hasattr(policy, "lstm_actor"):
        raise ValueError(
            f"{type(model).__name__} remembers (an LSTM), and a portable policy does not: keep the "
            "model's own zip, or train with ppo, sac or tqc."
        )
    if hasattr(policy, "action_net"):  # actor and critic in one
        parts = [*policy.mlp_extractor.policy_net, policy.action_net]
        squash = bool(policy.squash_output)
    elif hasattr(policy.actor, "latent_pi"):  # SAC and its kin
        parts, squash = [*policy.actor.latent_pi, policy.actor.mu], True
    else:  # TD3 and DDPG: ends in a tanh of its own
        parts, squash = list(policy.actor.mu)[:-1], True
    kinds = {nn.Tanh: "tanh", nn.ReLU: "relu"}
    used = {type(p) for p in parts} - {nn.Linear}
    if len(used) > 1 or not used <= kinds.keys():
        names = ", ".join(sorted(kind.__name__ for kind in used))
        raise ValueError(f"a portable policy has dense layers with tanh or relu, got {names}.")
    layers = [
        (p.weight.detach().cpu().numpy(), p.bias.detach().cpu().numpy())
        for p in parts
        if isinstance(p, nn.Linear)
    ]
    return layers, kinds[used.pop()] if used else "tanh", squash


def _checked(given: Normalisation, n: int) -> Normalisation:
    """`given` with arrays of its own; ValueError where they do not fit."""
    mean, variance = real_array("mean", given.mean), real_array("variance", given.variance)
    for name, array in (("mean", mean), ("variance", variance)):
        shaped(name, array, (n,), "a number per observation")
    if (variance < 0.0).any():
        raise ValueError(f"variance must not be negative, got {variance.min()}.")
    if not given.clip > 0.0 or not given.epsilon >= 0.0:
        raise ValueError(
            f"clip must be positive and epsilon not negative, got {given.clip} and {given.epsilon}."
        )
    return dataclasses.replace(given, mean=mean, variance=variance)


def _checked_layers(
    layers: Sequence[tuple[ArrayLike, ArrayLike]], n: int, actions: int
) -> list[tuple[Single, Single]]:
    """Layers as float32 arrays; ValueError unless they lead from n observations to the actions."""
    if not layers:
        raise ValueError("layers must hold at least one pair of weights and biases, got none.")
    found = []
    width = n
    for i, (weights, bias) in enumerate(layers):
        w, b = real_array(f"weights.{i}", weights), real_array(f"bias.{i}", bias)
        outputs = actions if i == len(layers) - 1 else len(b)
        shaped(f"weights.{i}", w, (outputs, width), "outputs by inputs of the layer")
        shaped(f"bias.{i}", b, (outputs,), "a bias per output")
        width = outputs
        found.append((w.astype(np.float32), b.astype(np.float32)))
    return found


def located(name: str | os.PathLike[str]) -> Path:
    """A learned thing's path: as given, or, of a bare name that is no file here, the shipped one's.

    Raises FileNotFoundError for the name of a problem that no policy is shipped for.
    """
    path = Path(name)
    there = any(file.exists() for file in portable.pair(path))
    ours = PRETRAINED / path
    known = len(path.parts) == 1 and portable.pair(ours)[0].exists()
    if not there and not known and str(name) in PROBLEMS:
        raise FileNotFoundError(none_for(str(name)))
    return ours if known and not there else path


def shipped(name: str) -> Policy:
    """A policy that comes with navgym: "auv" or "deck"; ValueError for another name."""
    found = _shipped()
    if name not in found and name in PROBLEMS:
        raise ValueError(none_for(name))
    return Policy.load(PRETRAINED / one_of("shipped policy", name, found))


def _shipped() -> list[str]:
    """Names of the policies that come with navgym."""
    return sorted(p.stem for p in PRETRAINED.glob("*.json") if p.stem != "combiner")


def none_for(problem: str) -> str:
    """A sentence for whoever asks for a policy of a problem that none is shipped for."""
    return (
        f"navgym ships no policy for {problem!r}, only for {', '.join(_shipped())}: train one with "
        f"`navgym train`, which lists its presets, and name its path. docs/agents.md says why."
    )
