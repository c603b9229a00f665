"""How fast navgym is, as ratios to well-known things measured in the same run.

    python scripts/benchmark.py auv            print the table
    python scripts/benchmark.py auv --write    also write docs/benchmarks-auv.md

Machines are noisy, so each pair is run in turns, and the median of the ratios is what counts. The
peers filterpy and (if it is installed: pip install dynamax) dynamax are optional.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import navgym
from navgym.batch import Batch
from navgym.estimation import run
from navgym.simulation import simulate_many

ENV = "navgym/AUVDropout-v0"
FIVE_SWEEPS = {"vb_iterations": 5}
THREE = ("prior_count", "forgetting", "process_noise_scale")  # so that sweeps stay at five
DOCS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks-auv.md"


@dataclass(frozen=True)
class Row:
    """One line of the table: what was measured, what it should be, and what it was."""

    what: str
    wanted: str
    found: str


def seconds(task: Callable[[], Any]) -> float:
    """Wall time of one call."""
    began = time.perf_counter()
    task()
    return time.perf_counter() - began


def paired(
    ours: Callable[[], Any], theirs: Callable[[], Any], rounds: int
) -> tuple[float, float, float]:
    """Median times of both, run in turns, and the median ratio theirs over ours."""
    ours(), theirs()
    times = [(seconds(ours), seconds(theirs)) for _ in range(rounds)]
    ratios = [b / a for a, b in times]
    mine, other = (statistics.median(column) for column in zip(*times, strict=True))
    return mine, other, statistics.median(ratios)


def episodes(env: gymnasium.Env[Any, Any], steps: int) -> Callable[[], None]:
    """A task: `steps` steps with random actions and resets in between."""
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(256)]

    def task() -> None:
        for k in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[k & 255])
            if terminated or truncated:
                env.reset()

    return task


def single_environment(rounds: int) -> list[Row]:
    """Steps per second of one lane against CartPole, both through gym.make."""
    steps = 8000
    what = "single env, decision_interval 1, 5 sweeps, against CartPole-v1"
    rows = []
    for kind, arguments in (("pool of 64 recordings", {"pool": 64}), ("new recordings", {})):
        ours = gymnasium.make(
            ENV, decision_interval=1, action_parameters=THREE, reference=FIVE_SWEEPS, **arguments
        )
        mine, other, ratio = paired(
            episodes(ours, steps), episodes(gymnasium.make("CartPole-v1"), steps), rounds
        )
        found = f"{ratio:.2f}x ({steps / mine:,.0f} against {steps / other:,.0f} steps/s)"
        rows.append(Row(f"{what}, {kind}", "at least 1x", found))
    return rows


def batch_environment(rounds: int, **arguments: Any) -> float:
    """Filter steps per second of 128 lanes on one core: observations, reference and reward too."""
    lanes, decisions = 128, 160
    env = gymnasium.make_vec(
        ENV, num_envs=lanes, action_parameters=THREE, reference=FIVE_SWEEPS, **arguments
    )
    env.reset(seed=0)
    actions = env.action_space.sample()

    def task() -> None:
        for _ in range(decisions + 1):  # one full episode of each lane, its restart included
            env.step(actions)

    task()
    return lanes * decisions * 5 / statistics.median(seconds(task) for _ in range(rounds))


def batches(rounds: int) -> list[Row]:
    """The batch environment with a pool of recordings, and with a new one per episode."""
    wanted = "at least .5 M filter steps/s per core"
    pool = batch_environment(rounds, pool=256)
    fresh = batch_environment(rounds)
    return [
        Row("batch env, 128 lanes, pool of 256 recordings", wanted, f"{pool / 1e6:.2f} M/s"),
        Row("batch env, 128 lanes, simulated anew at each reset", "told", f"{fresh / 1e6:.2f} M/s"),
    ]


def objective(rounds: int) -> Row:
    """Cost of one evaluation of a tuning objective per filter step, everything included."""
    from tuning.objective import Objective

    batch = Batch.of(simulate_many("auv/switch-D", navgym.seeds("train", 40), steps=800))
    evaluate = Objective("qivbf", ("forgetting", "process_noise_scale"), batch)
    values = {"forgetting": 0.9, "process_noise_scale": 3.0}
    evaluate(values)
    cost = statistics.median(seconds(lambda: evaluate(values)) for _ in range(4 * rounds))
    return Row(
        "tuning objective, qivbf, 40 x 800 steps", "at most 2.5 µs per filter step",
        f"{cost / 32000 * 1e6:.2f} µs",
    )  # fmt: skip


def against_filterpy(rounds: int) -> Row:
    """`kf` against filterpy's KalmanFilter on the same series."""
    from filterpy.kalman import KalmanFilter

    recordings = simulate_many("auv/nominal", navgym.seeds("test", 20))
    batch = Batch.of(recordings)

    def theirs() -> None:
        for r in recordings:
            kf = KalmanFilter(dim_x=4, dim_z=4)
            model = r.model
            kf.x, kf.P = model.x0.copy(), model.P0.copy()
            kf.F, kf.H, kf.Q, kf.R = model.F, model.H, model.Q, model.R
            for z, gone in zip(r.measurements, r.lost[:, 0], strict=True):
                kf.predict()
                kf.update(None if gone else z)

    _, _, ratio = paired(lambda: run("kf", batch), theirs, rounds)
    return Row("kf against filterpy, 20 series of 500", "at least 100x", f"{ratio:,.0f}x")


def against_dynamax(rounds: int) -> Row:
    """`kf` over 1000 series against dynamax's jitted, vmapped filter (no losses: it has none)."""
    # with one model and no loss, vmap computes the covariances once for all series; kf per series
    what = "kf against dynamax jit+vmap (one covariance for all), 1000 series of 500, no loss"
    if importlib.util.find_spec("dynamax") is None:
        return Row(what, "told", "not measured: pip install dynamax")
    import jax
    from dynamax.linear_gaussian_ssm import LinearGaussianSSM, lgssm_filter

    jax.config.update("jax_enable_x64", True)
    batch = Batch.of(simulate_many("auv/nominal", navgym.seeds("test", 1000), loss=0.0))
    model = navgym.LinearModel()
    # dynamax predicts after the update; start it one prediction later
    x1 = model.F @ model.x0
    P1 = model.F @ model.P0 @ model.F.T + model.Q
    parameters, _ = LinearGaussianSSM(4, 4).initialize(
        jax.random.PRNGKey(0), initial_mean=x1, initial_covariance=P1,
        dynamics_weights=model.F, dynamics_covariance=model.Q,
        emission_weights=model.H, emission_covariance=model.R,
    )  # fmt: skip
    many = jax.jit(jax.vmap(lambda y: lgssm_filter(parameters, y).filtered_means))
    theirs = np.asarray(many(batch.y))
    if not np.allclose(theirs, run("kf", batch)["states"], atol=1e-6):
        raise RuntimeError("dynamax and navgym disagree: the comparison would be meaningless.")
    mine, other, ratio = paired(
        lambda: run("kf", batch), lambda: many(batch.y).block_until_ready(), rounds
    )
    return Row(what, "told", f"{ratio:.1f}x ({mine * 1e3:.0f} against {other * 1e3:.0f} ms)")


def python(code: str) -> float:
    """Wall time of `code` in a fresh interpreter, by its own clock."""
    script = f"import time; t = time.perf_counter()\n{code}\nprint(time.perf_counter() - t)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def start_up(rounds: int) -> list[Row]:
    """Import time, and the time to a first step with kernels on disk."""
    first_step = (
        "import gymnasium, navgym\n"
        f"env = gymnasium.make({ENV!r}); env.reset(seed=0); env.step(env.action_space.sample())"
    )
    python(first_step)
    imported = statistics.median(python("import navgym") for _ in range(rounds))
    stepped = statistics.median(python(first_step) for _ in range(rounds))
    return [
        Row("import navgym", "under .5 s", f"{imported:.2f} s"),
        Row("import to first step, kernels on disk", "under 2 s", f"{stepped:.2f} s"),
    ]


def filters_table(rounds: int) -> list[Row]:
    """Cost of each filter per sample, one core."""
    batch = Batch.of(simulate_many("auv/switch-D", navgym.seeds("test", 50)))
    rows = []
    for name in navgym.filters():
        try:
            run(name, batch)
        except ValueError:
            continue
        cost = statistics.median(seconds(lambda n=name: run(n, batch)) for _ in range(rounds))
        rows.append(Row(f"filter {name}", "told", f"{cost / batch.lost[..., 0].size * 1e6:.2f} µs"))
    return rows


def simulation(rounds: int) -> Row:
    """1000 recordings of 800 steps."""
    cost = statistics.median(
        seconds(lambda: simulate_many("auv/switch-D", navgym.seeds("train", 1000)))
        for _ in range(max(rounds // 2, 1))
    )
    return Row("simulate 1000 recordings of 800 steps", "about 1 s", f"{cost:.2f} s")


def auv(rounds: int) -> list[Row]:
    """Every figure of the AUV half."""
    parts: list[Callable[[int], Row | list[Row]]] = [
        single_environment, batches, objective, against_filterpy, against_dynamax, simulation,
        start_up, filters_table,
    ]  # fmt: skip
    rows: list[Row] = []
    for part in parts:
        print(f"measuring {part.__name__.replace('_', ' ')} ...", file=sys.stderr)
        found = part(rounds)
        more = found if isinstance(found, list) else [found]
        for row in more:
            print(f"  {row.what}: {row.found} (wanted: {row.wanted})", file=sys.stderr)
        rows += more
    return rows


def as_markdown(rows: list[Row]) -> str:
    """The table with what is needed to read it."""
    load = os.getloadavg()[0]
    lines = [
        "# How fast: the AUV half",
        "",
        "Written by `python scripts/benchmark.py auv --write`. Pairs were run in turns; a ratio is "
        "the median over the turns.",
        "",
        f"navgym {navgym.__version__}, Python {platform.python_version()}, "
        f"{os.cpu_count()} cores ({platform.machine()}), load {load:.1f}.",
        "",
        "| what | wanted | found |",
        "|---|---|---|",
        *(f"| {r.what} | {r.wanted} | {r.found} |" for r in rows),
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("half", choices=["auv"], help="which half of navgym to measure")
    parser.add_argument("--rounds", type=int, default=7, help="turns per pair (default: 7)")
    parser.add_argument("--write", action="store_true", help=f"write docs/{DOCS.name}")
    options = parser.parse_args()
    text = as_markdown(auv(options.rounds))
    print(text)
    if options.write:
        DOCS.write_text(text)


if __name__ == "__main__":
    main()
