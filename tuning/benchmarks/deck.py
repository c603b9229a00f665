"""How fast the deck is: against a plain numpy EKF, fastrvm and itself, in the same run."""

from __future__ import annotations

import importlib.util
import statistics
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from scipy.spatial.transform import Rotation

import navgym
from navgym.core.checks import Array
from navgym.deck.batch import DeckBatch
from navgym.deck.estimation import flexure_increments
from navgym.deck.live_bank import BANKS
from navgym.deck.model import lever_matrix
from navgym.deck.problem import PROBLEM
from navgym.identification import METHODS, RVM, identify
from navgym.simulation import simulate_many
from navgym.tuning.benchmarks.timing import Row, episodes, measured, paired, python, seconds

ENV = "navgym/DeckDeformation-v0"


def filtering(rounds: int) -> list[Row]:
    """Cost of the 24-state step, of 300 s, and both against a plain numpy EKF and the simulator."""
    recordings = simulate_many("deck/paper", navgym.seeds("test", 4))
    batch = DeckBatch.of(recordings)
    steps = int(batch.lengths.sum())
    small = DeckBatch.of(simulate_many("deck/paper", navgym.seeds("test", 1), duration=10.0))
    mine, other, ratio = paired(
        lambda: PROBLEM.run("alignment", small), lambda: numpy_ekf(small), max(rounds // 2, 2)
    )
    found = [
        Row(
            "alignment against a dense numpy EKF, 200 steps", "told",
            f"{ratio:,.0f}x ({mine / 200 * 1e6:.1f} against {other / 200 * 1e6:,.0f} µs per step)",
        )
    ]  # fmt: skip
    for name, parameters in (("alignment", {}), ("alignment_mcc", {"kernel_width": 5.0})):
        cost = _median(lambda n=name, p=parameters: PROBLEM.run(n, batch, p), rounds)
        wanted = "at most 6 µs" if name == "alignment_mcc" else "told"
        found.append(Row(f"{name}, one 24-state step", wanted, f"{cost / steps * 1e6:.2f} µs"))
    found += banks(rounds)
    whole = _median(lambda: PROBLEM.run("alignment_mcc", batch), rounds) / len(batch)
    ready = _median(lambda: DeckBatch.of(recordings), rounds) / len(batch)
    made = _median(lambda: simulate_many("deck/paper", range(4)), rounds) / len(batch)
    both = whole + ready
    return [
        *found,
        Row("300 s at 20 Hz, filter only", "under 40 ms", f"{1e3 * whole:.0f} ms"),
        Row("mechanisation of 300 s at 100 Hz, both IMUs", "told", f"{1e3 * ready:.0f} ms"),
        Row("simulating 300 s at 100 Hz over mechanising and filtering it", "at most 1x",
            f"{made / both:.2f}x ({1e3 * made:.0f} against {1e3 * both:.0f} ms)"),
    ]  # fmt: skip


def banks(rounds: int) -> list[Row]:
    """Cost of the bank's step, four modes of 36 states each, over recordings and live."""
    batch = DeckBatch.of(simulate_many("deck/switch-60", navgym.seeds("test", 2)))
    steps, found = int(batch.lengths.sum()), []
    cases = (("deck_bank", False, 30), ("deck_bank", True, 60), ("deck_bank_lever", True, 60))
    for name, late, most in cases:
        cost = _median(lambda n=name, e=late: PROBLEM.run(n, batch, everything=e), rounds)
        what = ", θ̇ 50 and 100 ms late and all covariances told" if late else ""
        told = f"{cost / steps * 1e6:.1f} µs"
        found.append(Row(f"{name}, four modes, one step{what}", f"at most {most} µs", told))
    return found + [_live_bank(n, batch.recordings[0], rounds) for n in BANKS]


def _live_bank(name: str, recording: Any, rounds: int) -> Row:
    """Cost of a filter step of a live bank, its five samples included."""
    live = navgym.LiveDeckBank(recording.model, filter_name=name, interval=recording.interval)
    samples = list(live.samples(recording))

    def follow() -> None:
        live.reset()
        for sample, time, _ in samples:
            live.step(sample, time=time)

    cost = _median(follow, rounds) / recording.steps * 1e6
    return Row(f"{name} live, five samples a step", "at most 60 µs", f"{cost:.0f} µs")


def _median(task: Any, rounds: int) -> float:
    task()
    return statistics.median(seconds(task) for _ in range(rounds))


def numpy_ekf(batch: DeckBatch) -> Array:
    """The alignment filter as most people would write it: dense matrices, one block update."""
    recording, tape = batch.recordings[0], batch.tapes[0]
    model, dt, eye = recording.model, batch.step, np.eye(3)
    flexure, L0 = model.flexure, lever_matrix(model.lever_arm)
    phi, noise = flexure.transition(dt), flexure.process_noise(dt)
    std = np.repeat(
        [model.misalignment, 1e-6, 1e-8, model.gyro_bias, model.accelerometer_bias, 1e-6], 3
    )
    P = np.diag(np.concatenate([std, flexure.sigma, flexure.rate_sigma]) ** 2)
    x, states = np.zeros(24), np.zeros((len(tape), 24))
    before = np.hstack([_cross(tape["omega"][0]) @ L0, L0])
    R = np.diag([0.2**2] * 3 + list(model.rate_noise**2 + flexure.noise_density * dt / 3))
    for k, s in enumerate(tape):
        C_s, C_m = _matrix(s["q_mid"]), _matrix(s["q_m"])
        B = C_m @ np.hstack([_cross(s["omega"]) @ L0, L0])
        T, Q = np.zeros((6, 6)), np.zeros((24, 24))
        W = np.zeros((6, 6))
        for a in range(3):
            T[np.ix_([a, 3 + a], [a, 3 + a])] = phi[a]
            W[np.ix_([a, 3 + a], [a, 3 + a])] = noise[a]
        F = np.eye(24)
        F[3:6, 6:9], F[3:6, 12:15], F[6:9, 9:12] = _cross(s["dV"]), dt * C_s, -dt * C_s
        F[15:18, 18:], F[18:, 18:] = B @ T - before, T
        Q[3:6, 3:6] = model.accelerometer_noise**2 * dt * eye
        Q[6:9, 6:9] = model.gyro_noise**2 * dt * eye
        G = np.vstack([B, np.eye(6)])
        Q[15:, 15:] = G @ W @ G.T
        x, P, before = F @ x, F @ P @ F.T + Q, B
        l, d, r = x[:3], s["w_s"], C_m @ x[21:]  # noqa: E741
        d = np.cross(s["w_s"], x[6:9]) + C_s @ x[9:12]
        up, down = eye + _cross(l), eye - _cross(l)
        V, w = s["V_s"] + s["V_m"], s["w_s"] + s["w_m"]
        h = np.concatenate(
            [np.cross(V, l) + up @ x[3:6] + down @ x[15:18], np.cross(w, l) + up @ d + down @ r]
        )
        H = np.zeros((6, 24))
        H[:3, :3], H[:3, 3:6], H[:3, 15:18] = _cross(V - x[3:6] + x[15:18]), up, down
        H[3:, :3], H[3:, 6:9], H[3:, 9:12] = _cross(w - d + r), up @ _cross(s["w_s"]), up @ C_s
        H[3:, 21:] = down @ C_m
        z = np.concatenate([s["V_s"] - s["V_m"], s["w_s"] - s["w_m"]])
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        x = x + K @ (z - h)
        I_KH = np.eye(24) - K @ H
        P = I_KH @ P @ I_KH.T + K @ R @ K.T
        states[k] = x
    return states


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _matrix(q: Array) -> Array:
    return np.asarray(Rotation.from_quat(q.copy(), scalar_first=True).as_matrix())


def environments(rounds: int) -> list[Row]:
    """Environment steps per second: one lane, and 64 in a batch, one second of data each."""
    steps = 4000
    single = gymnasium.make(ENV, pool=16)
    mine, other, ratio = paired(
        episodes(single, steps), episodes(gymnasium.make("CartPole-v1"), steps), rounds
    )
    fresh = _median(episodes(gymnasium.make(ENV), 1260), max(rounds // 2, 1))
    rows = [
        Row("single env, 1 s per step, pool of 16 recordings", "at least 2500 steps/s",
            f"{steps / mine:,.0f} steps/s ({ratio:.2f}x CartPole's {steps / other:,.0f})"),
        Row("single env, a new recording of 480 s per episode", "told", f"{1260 / fresh:,.0f} steps/s"),
    ]  # fmt: skip
    lanes, decisions = 64, 60
    batch = gymnasium.make_vec(ENV, num_envs=lanes, pool=32)
    batch.reset(seed=0)
    actions = batch.action_space.sample()

    def task() -> None:
        for _ in range(decisions):
            batch.step(actions)

    rate = lanes * decisions / _median(task, rounds)
    return [
        *rows,
        Row(
            "batch env, 64 lanes",
            "at least 2500 lane-steps/s per core",
            f"{rate:,.0f} lane-steps/s",
        ),
    ]


def vectors(rounds: int) -> list[Row]:
    """The relevance vector machine against fastrvm, sinc with noise."""
    if importlib.util.find_spec("fastrvm") is None:
        return [Row("RVM against fastrvm", "at most its time", "not measured: pip install fastrvm")]
    from fastrvm import RVR

    rows = []
    for n in (300, 1000):
        rng = np.random.default_rng(0)
        x = np.linspace(-10.0, 10.0, n)
        y = np.sinc(x / np.pi) + 0.1 * rng.standard_normal(n)
        ours = lambda x=x, y=y: RVM(kernel="gaussian", scale=3.0, bias=False).fit(x, y)  # noqa: E731
        theirs = lambda x=x, y=y: RVR(kernel="rbf", gamma=1.0 / 9.0).fit(x[:, None], y)  # noqa: E731
        mine, other, ratio = paired(ours, theirs, rounds)
        rows.append(Row(f"RVM, N = {n}, against fastrvm", "at most its time",
                        f"{1 / ratio:.2f}x ({1e3 * mine:.1f} against {1e3 * other:.1f} ms)"))  # fmt: skip
    return rows


def identifications(rounds: int) -> list[Row]:
    """One identification of three axes from 300 s, by every method."""
    recording = simulate_many("deck/paper", navgym.seeds("test", 1))[0]
    increments = flexure_increments(recording)
    return [
        Row(f"identify by {m}, 300 s, three axes", "at most 100 ms",
            f"{1e3 * _median(lambda m=m: identify(m, increments, recording.step), rounds):.0f} ms")
        for m in METHODS
    ]  # fmt: skip


def filters_table(rounds: int) -> list[Row]:
    """Cost of each filter per step, identification included."""
    batch = DeckBatch.of(simulate_many("deck/switch-60", navgym.seeds("test", 2)))
    steps = int(batch.lengths.sum())
    return [
        Row(f"filter {name}", "told", f"{_median(lambda n=name: PROBLEM.run(n, batch), max(rounds // 3, 1)) / steps * 1e6:.1f} µs per step")
        for name in PROBLEM.filters
    ]  # fmt: skip


def start_up(rounds: int) -> Row:
    """Time to a first step in a fresh interpreter, kernels on disk."""
    code = (
        "import gymnasium, navgym\n"
        f"env = gymnasium.make({ENV!r}); env.reset(seed=0); env.step(env.action_space.sample())"
    )
    python(code)
    spent = statistics.median(python(code) for _ in range(rounds))
    return Row("import to first step, kernels on disk", "at most .5 s", f"{spent:.2f} s")


def deck(rounds: int) -> list[Row]:
    """Every figure of the deck."""
    parts: list[Callable[[int], Row | list[Row]]] = [
        filtering, environments, vectors, identifications, filters_table, start_up,
    ]  # fmt: skip
    return measured(parts, rounds)
