"""`navgym train`: a preset or a TOML file, and any field of a configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from navgym.agents.training.configuration import Configuration, presets
from navgym.command import as_typed
from navgym.core.atomic import replacing
from navgym.core.checks import one_of, positive_int
from navgym.tuning.commands.parse import parse as parsed

ABOUT = """Train a policy that sets a filter's parameters while it runs.

    navgym train                      a specialist for auv/switch-D, in half a minute
    navgym train deck --seed 1        another preset, and any option below
    navgym train runs/mine/config.toml --decisions 2000000
    navgym train auv --search 20      tune the agent's own hyper-parameters with Optuna
    navgym train auv --log a.csv b.csv          a small policy for one's own vessel, from tuned parameters
    navgym train --kind mixture --log a.csv b.csv    a mixture of fixed filters, in seconds: the better of the
                                      two on real tracks; --kind mixture --help shows its options

presets (give one as the first word; --help after it shows its values):
{presets}

Everything goes to one folder (--out): policy.npz and policy.json (numpy alone runs them), config.toml,
training.json, training.html with the learning curve, TensorBoard's logs, checkpoints. Stopped by Ctrl-C
or killed, the same command goes on from the last checkpoint. Validation recordings choose the
policy; `navgym evaluate OUT/policy.npz` then says what it is worth on fresh ones.
"""


@dataclass(frozen=True)
class Command:
    """What was asked for."""

    configuration: Annotated[Configuration, tyro.conf.arg(name="")]
    fresh: bool = False
    """start anew, even if the folder holds a training that could be continued"""
    search: int = 0
    """tune the recipe with this many short trainings instead of training once"""

    def __post_init__(self) -> None:
        positive_int("search", self.search, least=0)
        if self.search and self.fresh:
            raise ValueError("--fresh is for a training; a search begins anew in another --out.")
        if self.search and self.configuration.log:
            raise ValueError("--search is for simulated recordings: leave it out with --log.")


def parse(words: Sequence[str]) -> Command:
    """The command line's words as a `Command`; exits with a message for wrong ones.

    Raises ValueError for a file or a field with a value that cannot be.
    """
    rest = list(words)
    base = Configuration()
    if rest and not rest[0].startswith("-"):
        word = rest.pop(0)
        base = _base(f"{word}-logs" if "--log" in rest and f"{word}-logs" in presets() else word)
    elif "--log" in rest:
        base = _base("auv-logs")
    known = presets()
    width = max(map(len, known))
    listed = "\n".join(f"  {name.ljust(width)}  {text}" for name, (text, _) in known.items())
    about = ABOUT.format(presets=listed)
    return parsed(Command, "train [PRESET | FILE.toml]", about, rest, Command(base))


KINDS = ("policy", "mixture")


def kind_of(words: Sequence[str]) -> tuple[str, list[str]]:
    """What is to be trained, as `--kind` says, and the other words; ValueError for an unknown kind."""
    rest = list(words)
    if "--kind" not in rest:
        return KINDS[0], rest
    at = rest.index("--kind")
    told = rest[at + 1] if at + 1 < len(rest) else ""
    del rest[at : at + 2]
    return one_of("--kind", told, KINDS), rest


def main(words: Sequence[str]) -> int:
    """Train, or search for a recipe; returns the exit status."""
    kind, words = kind_of(words)
    if kind == "mixture":
        from navgym.agents.mixture import command as mixture

        return mixture.main(words)
    command = parse(words)
    return _search(command) if command.search else _train(command, as_typed("train", words))


def _train(command: Command, typed: str) -> int:
    from navgym.agents.training.run import train

    config = command.configuration
    print(f"training into {config.folder} (TensorBoard: tensorboard --logdir {config.folder})")
    made = train(config, command.fresh, command=typed)
    against = "tuned parameters" if config.log else "best fixed parameters"
    for name, gains in made.best.scores["gains"].items():
        each = ", ".join(f"{quantity} {100 * gain:+.1f} %" for quantity, gain in gains.items())
        print(f"{name} (validation, against {against}): {each}")
    print(f"learning curve: {made.folder / 'training.html'}")
    if made.policy is not None:
        where = " --log OTHER ..." if config.log else ""
        what = "other logs" if config.log else "fresh seeds"
        print(f"next, on {what}: navgym evaluate {made.folder / 'policy.npz'}{where}")
    return 0


def _search(command: Command) -> int:
    from navgym.agents.training.hyperparameters import tune

    config = command.configuration
    found, best = tune(config, command.search)
    path = config.folder / "best-recipe.toml"
    with replacing(path, text=True) as file:
        file.write(replace(best, out=None).to_toml())
    first = found.trials[0]
    print(f"score {1 - first.result:.4f} with the first recipe, {1 - found.best.result:.4f} with")
    for name, value in found.best.values.items():
        print(f"  {name} = {value:.4g}")
    print(f"next: navgym train {path} --out {config.folder / 'best'}")
    return 0


def _base(word: str) -> Configuration:
    """What the first word means."""
    known = presets()
    if word in known:
        return known[word][1]
    path = Path(word)
    if path.suffix == ".toml":
        return Configuration.from_toml(path)
    raise ValueError(f"{word!r} is neither a preset nor a TOML file. Presets: {', '.join(known)}.")
