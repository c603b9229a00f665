"""How fast the AUV is, against well-known things measured in the same run."""

from __future__ import annotations

import functools
import importlib.util
import statistics
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import navgym
from navgym.auv.problem import PROBLEM
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.tuning.benchmarks.timing import (
    Row,
    compiled,
    episodes,
    measured,
    paired,
    python,
    seconds,
)

ENV = "navgym/AUVDropout-v0"
FIVE_SWEEPS = {"vb_iterations": 5}
COMPILE = """
import numpy as np, navgym, navgym.estimation
model = navgym.LinearModel(F=np.eye(8), Q=np.eye(8), H=np.eye(3, 8), R=np.eye(3), position=(0,))
recording = navgym.Recording(np.arange(20.0), np.ones((20, 3)), model=model)
navgym.estimate("{name}", recording)
"""
THREE = ("prior_count", "forgetting", "process_noise_scale")  # so that sweeps stay at five


def single_environment(rounds: int) -> list[Row]:
    """Steps per second of one lane against CartPole, both through gym.make."""
    steps = 8000
    what = "single env, decision_interval 1, 5 sweeps, against CartPole-v1"
    rows = []
    pools: dict[str, Any] = {"pool of 64 recordings": {"pool": 64}, "new recordings": {}}
    wanted = ("at least 1.3x", "at least 1x")
    for (kind, arguments), least in zip(pools.items(), wanted, strict=True):
        ours = gymnasium.make(
            ENV, decision_interval=1, action_parameters=THREE, reference=FIVE_SWEEPS, **arguments
        )
        mine, other, ratio = paired(
            episodes(ours, steps), episodes(gymnasium.make("CartPole-v1"), steps), rounds
        )
        found = f"{ratio:.2f}x ({steps / mine:,.0f} against {steps / other:,.0f} steps/s)"
        rows.append(Row(f"{what}, {kind}", least, found))
    return rows


def stepping(lanes: int, decisions: int = 160, **arguments: Any) -> Callable[[], None]:
    """A task: a full episode of each lane, its restart included, with random actions."""
    env = gymnasium.make_vec(
        ENV, num_envs=lanes, action_parameters=THREE, reference=FIVE_SWEEPS, **arguments
    )
    env.reset(seed=0)
    actions = env.action_space.sample()
    env.step(actions)

    def task() -> None:
        for _ in range(decisions + 1):
            env.step(actions)

    return task


def batch_environment(rounds: int, **arguments: Any) -> float:
    """Filter steps per second of 128 lanes on one core: observations, reference and reward too."""
    lanes, decisions = 128, 160
    task = stepping(lanes, decisions, **arguments)
    task()
    return lanes * decisions * 5 / statistics.median(seconds(task) for _ in range(rounds))


def batches(rounds: int) -> list[Row]:
    """The batch environment with a pool of recordings, and with a new one per episode."""
    pool = batch_environment(rounds, pool=256)
    fresh = batch_environment(rounds)
    return [
        Row(
            "batch env, 128 lanes, filter steps, pool of 256 recordings",
            "at least 2 M/s",
            f"{pool / 1e6:.2f} M/s",
        ),
        Row(
            "batch env, 128 lanes, filter steps, simulated anew at each reset",
            "at least 1 M/s",
            f"{fresh / 1e6:.2f} M/s",
        ),
    ]


def objective(rounds: int) -> Row:
    """Cost of one evaluation of a tuning objective per filter step, everything included."""
    from navgym.tuning.objectives import Objective

    batch = StateSpaceBatch.of(simulate_many("auv/switch-D", navgym.seeds("train", 40), steps=800))
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
    what = "kf against filterpy, 20 series of 500"
    if importlib.util.find_spec("filterpy") is None:
        return Row(what, "at least 150x", "not measured: pip install filterpy")
    from filterpy.kalman import KalmanFilter

    recordings = simulate_many("auv/nominal", navgym.seeds("test", 20))
    batch = StateSpaceBatch.of(recordings)

    def theirs() -> None:
        for r in recordings:
            kf = KalmanFilter(dim_x=4, dim_z=4)
            model = r.model
            kf.x, kf.P = model.x0.copy(), model.P0.copy()
            kf.F, kf.H, kf.Q, kf.R = model.F, model.H, model.Q, model.R
            for z, gone in zip(r.measurements, r.lost[:, 0], strict=True):
                kf.predict()
                kf.update(None if gone else z)

    _, _, ratio = paired(lambda: PROBLEM.run("kf", batch), theirs, rounds)
    return Row(what, "at least 150x", f"{ratio:,.0f}x")


def compiling(rounds: int) -> list[Row]:  # noqa: ARG001 - once: it takes long
    """Filters of a size that nothing was compiled for."""
    rows = []
    for name in ("kf", "qivbf", "ekf", "bank"):
        spent = compiled(COMPILE.format(name=name))
        what = f"compiling {name} for 8 states and 3 measurements"
        rows.append(Row(what, "at most 5 s", f"{spent:.1f} s of processor time"))
    return rows


def against_dynamax(rounds: int) -> Row:
    """`kf` over 1000 series against dynamax's jitted, vmapped filter (no losses: it has none)."""
    # with one model and no loss, vmap computes the covariances once for all series; kf per series
    what = "kf against dynamax jit+vmap (one covariance for all), 1000 series of 500, no loss"
    if importlib.util.find_spec("dynamax") is None:
        return Row(what, "at least 1x", "not measured: pip install dynamax")
    import jax
    from dynamax.linear_gaussian_ssm import LinearGaussianSSM, lgssm_filter

    jax.config.update("jax_enable_x64", True)
    batch = StateSpaceBatch.of(simulate_many("auv/nominal", navgym.seeds("test", 1000), loss=0.0))
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
    if not np.allclose(theirs, PROBLEM.run("kf", batch).states, atol=1e-6):
        raise RuntimeError("dynamax and navgym disagree: the comparison would be meaningless.")
    mine, other, ratio = paired(
        lambda: PROBLEM.run("kf", batch), lambda: many(batch.y).block_until_ready(), rounds
    )
    return Row(what, "at least 1x", f"{ratio:.1f}x ({mine * 1e3:.0f} against {other * 1e3:.0f} ms)")


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
        Row("import to first step, kernels on disk", "at most .5 s", f"{stepped:.2f} s"),
    ]


def filters_table(rounds: int) -> list[Row]:
    """Cost of each filter per sample, one core."""
    batch = StateSpaceBatch.of(simulate_many("auv/switch-D", navgym.seeds("test", 50)))
    rows = []
    for name in PROBLEM.filters:
        try:
            PROBLEM.run(name, batch)
        except ValueError:
            continue
        task = functools.partial(PROBLEM.run, name, batch)
        cost = statistics.median(seconds(task) for _ in range(rounds))
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
    """Every figure of the AUV."""
    return measured(
        [
            single_environment, batches, objective, against_filterpy, against_dynamax, simulation,
            start_up, compiling, filters_table,
        ],
        rounds,
    )  # fmt: skip
