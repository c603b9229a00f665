"""The whole state of a training in one file, so that a killed one goes on as if nothing had happened.

A checkpoint is an npz written whole or not at all, with a hash of its content; the last two are
kept. Networks and optimisers travel as torch's own bytes, which are read with `weights_only=True`:
nothing is unpickled. The hash notices damage and is no signature: a checkpoint that somebody forged
ends in an error, not in their code.
"""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import random
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.save_util import recursive_getattr
from stable_baselines3.common.vec_env import VecNormalize

from navgym.agents.policies.portable import digest
from navgym.agents.training.vec_env import LaneVecEnv
from navgym.core.atomic import replacing
from navgym.core.storage import parse_json, read_npz

Report = Callable[[str], None]  # takes lines of progress

KEPT = 2

Arrays = dict[str, NDArray[Any]]

_UNREADABLE = (
    ValueError, TypeError, EOFError, OSError, KeyError, zipfile.BadZipFile, zlib.error,
    NotImplementedError,
)  # fmt: skip

# what arrays and facts of other names, types and shapes end in; torch's word for what it won't unpickle
_MISFITS = (
    KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RuntimeError, EOFError,
    pickle.UnpicklingError,
)  # fmt: skip


@dataclass(frozen=True)
class Checkpoint:
    """A training between two updates.

    Args:
        arrays: numbers, by name.
        facts: the rest, as JSON holds it.
    """

    arrays: Mapping[str, NDArray[Any]]
    facts: Mapping[str, Any]


# ---- files -----------------------------------------------------------------------------------


def save(folder: Path, decisions: int, checkpoint: Checkpoint) -> Path:
    """Write a checkpoint into `folder` and drop all but the last two; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    facts = np.array(json.dumps(checkpoint.facts))
    arrays = dict(checkpoint.arrays) | {"facts": facts}
    path = folder / f"{decisions:012d}.npz"
    with replacing(path) as file:
        np.savez(file, allow_pickle=False, sha256=np.array(digest(arrays)), **arrays)
    for old in _all(folder)[KEPT:]:
        old.unlink(missing_ok=True)
    return path


def latest(folder: Path) -> tuple[Checkpoint | None, list[str]]:
    """The newest whole checkpoint in `folder`, or None, and what was wrong with newer ones."""
    problems: list[str] = []
    for path in _all(folder):
        try:
            return _load(path), problems
        except _UNREADABLE as error:
            problems.append(f"{path} is damaged ({error})")
    return None, problems


def to_continue(
    folder: Path,
    configuration: Mapping[str, Any],
    report: Report,
    current: Callable[[Mapping[str, Any]], Mapping[str, Any]] = dict,
) -> Checkpoint | None:
    """The checkpoint in a training's folder to go on from, if there is one.

    Args:
        folder: of the training; its `checkpoints` are looked at.
        configuration: what the training depends on, as JSON holds it.
        report: told of damaged checkpoints.
        current: (configuration of any earlier time) to the same in today's words.

    Raises:
        ValueError: the folder holds another training.
    """
    found, problems = latest(folder / "checkpoints")
    for problem in problems:
        report(f"{problem}: " + ("going back to the one before" if found else "starting anew"))
    if found is None:
        return None
    with fitting(folder):
        was = current(found.facts["configuration"])
    differing = sorted(n for n in {*was, *configuration} if was.get(n) != configuration.get(n))
    if differing:
        name = differing[0]
        raise ValueError(
            f"{folder} holds another training, which differs in {', '.join(differing)} ("
            f"{name} there: {was.get(name)!r}, asked for: {configuration.get(name)!r}): name "
            "another folder (--out), or start anew (--fresh)."
        )
    return found


def clear(folder: Path) -> None:
    """Remove every checkpoint."""
    for path in _all(folder):
        path.unlink()


def _all(folder: Path) -> list[Path]:
    """Checkpoints, newest first."""
    return sorted(folder.glob("[0-9]*.npz"), reverse=True)


def _load(path: Path) -> Checkpoint:
    arrays = read_npz(path, "is no checkpoint, or is truncated", "Remove it.")
    if str(arrays.pop("sha256")) != digest(arrays):
        raise ValueError("its content does not match its hash")
    facts = parse_json(str(arrays.pop("facts")))
    if not isinstance(facts, dict):
        raise ValueError("it lacks its facts")  # noqa: TRY004 - a file's fault
    return Checkpoint(arrays, facts)


@contextlib.contextmanager
def fitting(folder: Path) -> Iterator[None]:
    """ValueError where what a checkpoint holds, whole as it is, is not what the block asks of it."""
    try:
        yield
    except _MISFITS as error:
        what = f"{type(error).__name__}: {str(error)[:200]}"
        raise ValueError(
            f"the checkpoint in {folder} was written by another navgym or is forged ({what}): start "
            "anew (--fresh), or name another folder (--out)."
        ) from error


# ---- the state of a learner ----------------------------------------------------------------------


def capture(model: BaseAlgorithm, normaliser: VecNormalize, env: LaneVecEnv) -> Checkpoint:
    """Everything that the next update depends on."""
    arrays: Arrays = {"networks": _networks(model), "torch_rng": _torch_rng()}
    arrays |= {f"engine.{name}": array for name, array in env.engine.snapshot().items()}
    arrays |= {f"env.{name}": array for name, array in env.counters().items()}
    arrays |= {f"monitor.{name}": getattr(normaliser.venv, name).copy() for name in _MONITOR}
    for name in ("obs_rms", "ret_rms"):
        rms: Any = getattr(normaliser, name)
        arrays |= {f"{name}.mean": np.asarray(rms.mean), f"{name}.var": np.asarray(rms.var)}
        arrays[f"{name}.count"] = np.asarray(rms.count)
    arrays["returns"] = normaliser.returns.copy()
    for name in _MODEL_ARRAYS:
        if getattr(model, name, None) is not None:
            arrays[f"model.{name}"] = np.asarray(getattr(model, name)).copy()
    arrays |= _memory(model)
    state: Any = np.random.get_state(legacy=False)  # noqa: NPY002 - the learners draw from it
    arrays["numpy_rng"] = state["state"]["key"]
    facts = {
        "numpy_rng": {**state, "state": {"pos": int(state["state"]["pos"])}},
        "python_rng": random.getstate(),
        "lanes": [env.engine.generator(i).bit_generator.state for i in range(env.num_envs)],
        "actions_rng": model.action_space.np_random.bit_generator.state,
        "counts": {name: int(getattr(model, name)) for name in _MODEL_COUNTS},
    }
    return Checkpoint(arrays, facts)


def apply(
    checkpoint: Checkpoint, model: BaseAlgorithm, normaliser: VecNormalize, env: LaneVecEnv
) -> None:
    """Put a fresh learner with the same configuration where `capture` saw another."""
    import torch

    arrays, facts = checkpoint.arrays, checkpoint.facts
    env.reset()
    env.engine.restore(_under("engine.", arrays))
    env.restore(_under("env.", arrays))
    for i, state in enumerate(facts["lanes"]):
        env.engine.generator(i).bit_generator.state = state
    for name in _MONITOR:
        setattr(normaliser.venv, name, arrays[f"monitor.{name}"].copy())
    for name in ("obs_rms", "ret_rms"):
        rms: RunningMeanStd = getattr(normaliser, name)
        rms.mean, rms.var = arrays[f"{name}.mean"].copy(), arrays[f"{name}.var"].copy()
        rms.count = float(arrays[f"{name}.count"])
    normaliser.returns = arrays["returns"].copy()
    for name in _MODEL_ARRAYS:
        if f"model.{name}" in arrays:
            setattr(model, name, arrays[f"model.{name}"].copy())
    for name, value in facts["counts"].items():
        setattr(model, name, value)
    _restore_networks(model, arrays["networks"])
    _restore_memory(model, arrays)
    model.action_space.np_random.bit_generator.state = facts["actions_rng"]
    words: dict[str, Any] = dict(facts["numpy_rng"])
    words["state"] = {"key": arrays["numpy_rng"], **words["state"]}
    np.random.set_state(words)  # noqa: NPY002
    version, internal, following = facts["python_rng"]
    random.setstate((version, tuple(internal), following))
    torch.set_rng_state(torch.from_numpy(arrays["torch_rng"].copy()))


_MONITOR = ("episode_returns", "episode_lengths")
_MODEL_ARRAYS = ("_last_obs", "_last_episode_starts", "_last_original_obs")
_MODEL_COUNTS = ("num_timesteps", "_n_updates", "_episode_num")
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def _under(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _torch_rng() -> NDArray[Any]:
    import torch

    state: NDArray[Any] = torch.get_rng_state().numpy()
    return state


def packed(content: Any) -> NDArray[np.uint8]:
    """Tensors in dicts and lists as torch's bytes; see `unpacked`."""
    import torch

    buffer = io.BytesIO()
    torch.save(content, buffer)
    return np.frombuffer(buffer.getvalue(), dtype=np.uint8)


def unpacked(content: NDArray[np.uint8]) -> Any:
    """Inverse of `packed`; reads tensors and plain containers only."""
    import torch

    return torch.load(io.BytesIO(content.tobytes()), weights_only=True)


def _networks(model: BaseAlgorithm) -> NDArray[np.uint8]:
    """Networks, optimisers and single tensors."""
    _, variables = model._get_torch_save_params()
    tensors = {name: recursive_getattr(model, name).detach() for name in variables}
    states: Any = getattr(model, "_last_lstm_states", None)
    remembered = [[t.detach() for t in pair] for pair in states] if states is not None else []
    return packed({"parts": model.get_parameters(), "tensors": tensors, "memory": remembered})


def _restore_networks(model: BaseAlgorithm, content: NDArray[np.uint8]) -> None:
    found = unpacked(content)
    model.set_parameters(found["parts"], exact_match=True)
    for name, tensor in found["tensors"].items():
        recursive_getattr(model, name).data.copy_(tensor)
    if found["memory"]:
        states: Any = model._last_lstm_states  # type: ignore[attr-defined]
        model._last_lstm_states = type(states)(*(tuple(pair) for pair in found["memory"]))  # type: ignore[attr-defined]


def _memory(model: BaseAlgorithm) -> Arrays:
    """What an off-policy learner remembers."""
    if not isinstance(model, OffPolicyAlgorithm) or model.replay_buffer is None:
        return {}
    buffer = model.replay_buffer
    used = buffer.buffer_size if buffer.full else buffer.pos
    found = {f"replay.{name}": getattr(buffer, name)[:used] for name in _REPLAY}
    return found | {"replay_place": np.array([buffer.pos, buffer.full])}


def _restore_memory(model: BaseAlgorithm, arrays: Mapping[str, NDArray[Any]]) -> None:
    if not isinstance(model, OffPolicyAlgorithm) or model.replay_buffer is None:
        return
    buffer = model.replay_buffer
    for name in _REPLAY:
        kept = arrays[f"replay.{name}"]
        getattr(buffer, name)[: len(kept)] = kept
    place, full = arrays["replay_place"]
    buffer.pos, buffer.full = int(place), bool(full)
