"""`navgym combine`: train a combiner, and report on fresh seeds."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm

from navgym.agents.combiner.combiner import BANK, Combiner
from navgym.agents.combiner.material import CombinerConfiguration
from navgym.agents.policies.policy import located
from navgym.command import as_typed
from navgym.core.atomic import replacing
from navgym.core.checks import positive_int
from navgym.metrics import paired_difference
from navgym.problem import problem_of
from navgym.simulation import find_scenario
from navgym.tuning.cases import Cases
from navgym.tuning.commands.parse import parse

ABOUT = """Train the combiner: a network that weighs the modes of the frozen bank.

    navgym combine                                  one like that which navgym ships, in five minutes or so
    navgym combine --shifts                         report on shifted conditions, too
    navgym combine --evaluate combiner --shifts     report on the one that navgym ships
    navgym combine --evaluate runs/mine/combiner

Everything goes to one folder (--out): combiner.npz and combiner.json (a compiled kernel runs them,
without torch), report.json, checkpoints. Stopped by Ctrl-C or killed, the same command goes on from
the last checkpoint. Training, validation and test recordings are of different seeds.
"""
AS_DESIGNED = "as designed"

Condition = tuple[str, str, Mapping[str, Any]]


@dataclass(frozen=True)
class Command:
    """What was asked for."""

    configuration: Annotated[CombinerConfiguration, tyro.conf.arg(name="")]
    fresh: bool = False
    """start anew, even if the folder holds a training that could be continued"""
    evaluate: tuple[Path, ...] = ()
    """instead of training, report on these combiners: files, or combiner for the one that navgym ships"""
    report: int = 300
    """test recordings per condition; 0: no report"""
    shifts: bool = False
    """report on shifted conditions, and on the other scenarios, too"""

    def __post_init__(self) -> None:
        positive_int("report", self.report, least=0)
        if self.report == 1:
            raise ValueError("report must be 0, or at least 2 recordings for an interval, got 1.")


def main(words: Sequence[str]) -> int:
    """Train or only report; returns the exit status."""
    command = parse(Command, "combine", ABOUT, words, Command(CombinerConfiguration()))
    config = command.configuration
    if command.evaluate:
        config = dataclasses.replace(config, out=config.out or Path("runs/combiner/report"))
        chosen = {str(path): Combiner.load(located(path)) for path in command.evaluate}
    else:
        from navgym.agents.combiner.training import train

        print(f"training into {config.folder}")
        typed = as_typed("combine", words)
        chosen = {"combiner": train(config, command.fresh, command=typed)}
        print(f"made {config.folder / 'combiner.npz'}")
    if command.report:
        rows = compare(chosen, conditions(config, command.shifts), command.report)
        print(table(rows))
        config.folder.mkdir(parents=True, exist_ok=True)
        with replacing(config.folder / "report.json", text=True) as file:
            file.write(json.dumps(rows, indent=1) + "\n")
    return 0


def conditions(config: CombinerConfiguration, shifts: bool) -> list[Condition]:
    """What to report on: scenarios as they are; then their shifted versions, and the others."""
    own: list[Condition] = [(name, AS_DESIGNED, {}) for name in config.scenarios]
    if not shifts:
        return own
    shifted = [(name, *shift) for name in config.scenarios for shift in _shifts(name)]
    return own + shifted + [(name, AS_DESIGNED, {}) for name in config.others]


def _shifts(name: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Conditions that no policy was trained for, of a scenario."""
    scenario = find_scenario(name)
    yield from problem_of(scenario).contest.shifts(scenario).items()


def compare(
    combiners: Mapping[str, Combiner], on: Sequence[Condition], recordings: int
) -> list[dict[str, Any]]:
    """Errors on test recordings, and each combiner's paired gain over the bank.

    Args:
        combiners: by name.
        on: scenarios, names of conditions, and overrides that make them.
        recordings: per condition, at least 2.

    Returns one row per condition and combiner, as JSON can hold it: mean errors of bank,
    combiner and oracle, and the gain with its 95 % interval.
    """
    rows = []
    for name, condition, overrides in tqdm(on, desc="comparing on test seeds"):
        cases = Cases.simulated(name, "test", recordings, **overrides)
        problem, quantity = cases.problem, cases.first_quantity
        bank, oracle = (cases.errors(each)[0] for each in (BANK, problem.bound))
        for label, combiner in combiners.items():
            states = combiner.run(cases.batch).states
            own = problem.scoring.errors(cases.batch, states, (quantity,), cases.span)[quantity]
            gain = paired_difference(own, bank)
            rows.append(
                {
                    "scenario": name, "condition": condition, "combiner": label,
                    "recordings": recordings, "bank": float(bank.mean()),
                    "error": float(own.mean()), "oracle": float(oracle.mean()),
                    "difference": dataclasses.asdict(gain),
                }
            )  # fmt: skip
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of `compare` as text: errors, gains in % with 95 % intervals."""
    head = ("scenario", "condition", "combiner", "bank", "error", "oracle", "gain over bank, %")
    cells = [head]
    for row in rows:
        found = row["difference"]
        low, mean, high = (
            100.0 * found[name] for name in ("gain_low", "relative_gain", "gain_high")
        )
        numbers = (f"{row[name]:.4f}" for name in ("bank", "error", "oracle"))
        gain = f"{mean:+.2f} ({low:+.2f} to {high:+.2f})"
        cells.append((row["scenario"], row["condition"], row["combiner"], *numbers, gain))
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = ("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in cells)
    return "\n".join(line.rstrip() for line in lines)
