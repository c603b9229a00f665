"""`navgym retune`: which of a table of settings a recording's own fixes choose, afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from navgym.agents.combiner.combiner import combines
from navgym.agents.mixture.experts import Expert, known
from navgym.agents.mixture.retune import Retuned, retuned, settings_around
from navgym.agents.training.logs import Logs
from navgym.agents.training.reference import Start, checked
from navgym.command import as_typed
from navgym.core.atomic import writable_folder
from navgym.core.checks import one_of, positive_int
from navgym.tuned import as_model, read_tuned
from navgym.tuning.cases import Cases
from navgym.tuning.commands.parse import parse

ABOUT = """Let each recording's own position fixes choose among a table of settings, after the voyage.

    navgym retune monday.csv --start runs/tune/tuned.toml
    navgym retune monday.csv tuesday.csv --read position_noise 1.5 --out runs/retuned

The table: the tuned setting, its process noise and memory varied, and the bank. What is chosen has the least one-step error of the fixes on the whole recording, so it is for that
recording, estimated again: not for the next one, and not live. Where the log holds the truth the gain against
it is shown. Writes NAME.toml for each log to --out, which navgym.estimate reads.
"""


@dataclass(frozen=True)
class Options:
    """What was asked for."""

    log: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """the recordings"""
    start: Path | None = None
    """a tuned.toml to vary; by default the filter's defaults"""
    filter: str = "qivbf"
    """whose defaults, without start"""
    read: tuple[str, ...] = ()
    """what the logs' reader is told"""
    format: str | None = None
    """of the logs; by default what they look like"""
    draws: int = 10
    """of noise and losses per log and rate of losses, where the format draws them"""
    out: Path = Path("runs/retune")
    """folder of what was chosen"""

    def __post_init__(self) -> None:
        one_of("filter", self.filter, known())
        positive_int("draws", self.draws)


def main(words: Sequence[str]) -> int:
    """Choose, say and write; returns the exit status."""
    options = parse(Options, "retune", ABOUT, words)
    logs = Logs(options.log, options.read, options.format)
    if not combines(logs.problem):
        raise ValueError(
            f"{logs.paths[0].name} is a log of the {logs.problem.title}, which holds no position fixes to "
            "choose by: name logs that do."
        )
    table = settings_around(begun(options))
    folder, command = writable_folder("out", options.out), as_typed("retune", words)
    for i, path in enumerate(logs.paths):
        own = logs.only([i])
        for condition, cases in own.by_rate("test", options.draws).items():
            checked(cases, own)
            found = retuned(cases, table)
            print(f"{logs.name(path)}, {condition}: {told(found, cases)}")
            if len(cases) == 1:
                written(found, cases).save(folder / f"{path.stem}.toml", command)
    return 0


def begun(options: Options) -> Expert:
    """The setting that the table stands around."""
    if options.start is None:
        return Expert(options.filter)
    given = read_tuned(options.start)
    return Expert(given.filter, dict(given.parameters))


def told(found: Retuned, cases: Cases) -> str:
    """What was chosen, in words."""
    text = f"one-step error of the fixes {100 * found.gain:+.1f} %"
    if found.true_gain is not None:
        text += f", position error {100 * found.true_gain:+.1f} %"
    text += " better than with the setting it began with"
    if len(cases) > 1:
        kinds = len(set(found.which.tolist()))
        return f"{text} (means over {len(cases)} draws, which chose {kinds} settings)"
    own = found.picked(0)
    values = ", ".join(f"{n} {v:.4g}" if isinstance(v, float) else f"{n} {v}" for n, v in own.parameters.items())  # fmt: skip
    return f"{text}: {own.filter} with {values or 'its defaults'}"


def written(found: Retuned, cases: Cases) -> Start:
    """What was chosen, as a tuned.toml."""
    own = found.picked(0)
    about = {"chosen": "by the recording's own fixes, for this recording alone"}
    believed = as_model(cases.problem.noises(cases.batch))
    return Start(own.filter, dict(own.parameters), about, believed)
