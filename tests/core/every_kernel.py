"""Every kernel of navgym on something short: `python -m tests.core.every_kernel FILE` writes the numbers.

`numbers` gives the same ones whether kernels are compiled or, with NUMBA_DISABLE_JIT=1, run as
Python. Model sizes are those that `navgym.warm` compiles.
"""

import ast
import dataclasses
import inspect
import os
import sys
from pathlib import Path

import gymnasium
import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured

import navgym
import navgym.identification
from navgym.auv.live import LiveAUV
from navgym.auv.settings import AUVDropoutSettings
from navgym.deck import alignment
from navgym.deck.live import LiveDeck
from navgym.deck.scenarios import SLAM
from navgym.deck.settings import DeckDeformationSettings
from navgym.envs.actions import fill_rows
from navgym.inertial.mechanization import mechanise
from navgym.ins import estimation as ins_estimation
from navgym.ins.batch import InsBatch
from navgym.ins.catalogue import CATALOGUE
from navgym.ins.live import LiveINS
from navgym.ins.model import AidingModel
from navgym.ins.recording import Aiding
from navgym.ins.settings import INSDropoutSettings
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import combiner, modes
from navgym.statespace.filters import mixture as kernels
from tests.agents import mixtures
from tests.deck.lanes import outputs_for, prepare, rule_of, run_alignment, run_bank
from tests.helpers import NAMES
from tests.inertial import test_update
from tests.ins import lanes as ins_lanes

PACKAGE = Path(navgym.__file__).parent
AUV = (
    ("component-loss", ("kf", "kf_hold", "kf_extrapolate", "qivbf_printed")),
    ("component-loss", ("vbakf", "qivbf", "imm", "bank", "ekf", "cukf")),
    ("nominal", ("imm_wide", "bank", "bank_2026")),
    ("coordinated-turn", ("ekf", "ukf")),
    ("turn", ("kf_zero", "oracle")),
)  # fmt: skip


def numbers():
    """Arrays by name, from every family of kernels."""
    found = {}
    for part in (
        filters, mixture, mixed, deck, deck_bank, failing, updating, mechanised, inertial, identification,
        environments, live_auv, live_deck, live_ins,
    ):  # fmt: skip
        found |= {f"{part.__name__} {name}": plain(v) for name, v in part().items()}
    return found


def plain(value):
    """An array of numbers; fields of records side by side."""
    array = np.asarray(value)
    return np.array(structured_to_unstructured(array) if array.dtype.names else array, float)


def filters():
    """The AUV's simulator, and a filter of each family on what it makes."""
    found = {}
    for scenario, names in AUV:
        recording = navgym.simulate(f"auv/{scenario}", seed=3, steps=9)
        found[scenario] = recording.measurements
        for name in names:
            e = navgym.estimate(name, recording, {"fill": 1} if name == "qivbf" else None)
            found |= {f"{scenario} {name} {what}": getattr(e, what) for what in NAMES}
    model = navgym.LinearModel(R=1e-9 * np.eye(4), H=np.eye(4))  # the bank's updates lose digits
    exact = navgym.Recording(recording.time, recording.truth, recording.lost, model=model)
    found["exact"] = navgym.estimate("imm", exact).states
    loud = navgym.Recording(recording.time, recording.measurements, recording.lost, model=model)
    lost = dataclasses.replace(loud, lost=np.arange(len(loud)) % 4 == 1)
    for name in ("vbakf", "bank", "bank_2026"):  # R̂ at its bound; rows without a measurement
        found |= {
            f"{name} {i}": navgym.estimate(name, r).states for i, r in enumerate((loud, lost))
        }
    return found


def mixture():
    """The combiner, with a network that moves weights."""
    chosen, rng = modes.MODE_SETS["bank"], np.random.default_rng(5)
    arrays = {
        name: 0.1 * rng.standard_normal(shape)
        for name, shape in combiner.shapes(chosen, combiner.UNITS).items()
    }
    batch = StateSpaceBatch.of([navgym.simulate("auv/heavy", seed=1, steps=8, loss=0.3)])
    table = navgym.parameter_space("bank").array()[None]
    return combiner.estimate(
        combiner.pack(chosen, arrays), chosen, batch, table, everything=True, watch=True
    )


def mixed():
    """A mixture of fixed filters, and what it learns from."""
    rng = np.random.default_rng(6)
    z, errors, worth = rng.normal(size=(5, 3)), rng.normal(size=(5, 2, 2)), np.ones(5)
    slopes = np.zeros((3, 2)), np.zeros(2)
    able = np.arange(10).reshape(5, 2) > 0
    kernels.learn(z, errors, worth, able, rng.normal(size=(3, 2)), np.zeros(2), *slopes)
    found = mixtures.mixture().estimate(navgym.simulate("auv/heavy", seed=1, steps=8, loss=0.3))
    return {"states": found.states, "weights": found.extras["weights"], "slope": slopes[0]}


def deck():
    """The deck's simulator and the 24-state filter, by rules that reach all its branches."""
    recording = navgym.simulate("deck/glitch", seed=2, duration=0.4)
    own = {"velocity_noise": 0.1, "kernel_width": 3.0, "model_error_weight": 10.0}
    rules = {"iterations": 2}, {"by_noise": 1, "no_cross": 1, "printed_covariance": 1}
    found = {"angle": recording.sub_angle}
    for i, rule in enumerate(rules):
        run = run_alignment([recording], rule, **own)
        found |= {f"{i} {k}": v for k, v in run.items() if k not in ("lanes", "tapes")}
    return found


def deck_bank():
    """The deck's bank on slams and glitches, told the lever's error or a kernel width, and live."""
    events = dataclasses.replace(SLAM, slam_rate=20.0, glitch_rate=0.3)
    recording = navgym.simulate("deck/slam", seed=2, duration=0.3, regimes=(events,))
    sure = dataclasses.replace(
        recording, model=dataclasses.replace(recording.model, misalignment=1e-3)
    )
    found = {}
    for i, columns in enumerate(({"lever_sd": 0.1}, {"kernel_width": 3.0, "own_channels": 0.0})):
        run = run_bank([sure], **columns)
        found |= {f"{i} {k}": v for k, v in run.items() if k not in ("lanes", "tapes")}
    live = navgym.LiveDeckBank(sure.model, interval=sure.interval)
    found["smoothed"] = navgym.smooth("deck_bank_lever", sure).states
    return found | {"live": [each.state for each in live.follow(sure)]}


def failing():
    """Lanes of the deck filter that break: roots of negative numbers and quotients by zero."""
    recording = navgym.simulate("deck/paper", seed=2, duration=0.2)
    found = {}
    for name, factor, noise in (("negative", -1.0, 0.1), ("zero", 0.0, 0.0), ("huge", 1e300, 0.1)):
        lanes, models, tapes, row = prepare([recording], velocity_noise=noise, kernel_width=3.0)
        lanes["P"] *= factor
        out = outputs_for(tapes)
        alignment.run(lanes, models, tapes, rule_of(), row, 1, *out)
        found |= {f"{name} states": out[0], f"{name} report": out[1], name: lanes["diverged"]}
    return found


def updating():
    """The general update, trusting its rows or leaving out those beyond a gate."""
    lane, _ = test_update.problem(3)
    lane["innovation"][0, :2] = np.nan, 1e6
    found = {}
    for how in (test_update.TRUST, test_update.GATE):
        after = test_update.updated(lane, how, listen=True)
        found |= {f"{how} {name}": after[name] for name in ("x", "P", "nis")}
    return found


def mechanised():
    """A tape, field by field."""
    recording = navgym.simulate("deck/slam", seed=2, duration=0.5)
    tape = run_alignment([recording])["tapes"]
    return {name: tape[name] for name in tape.dtype.names}


def inertial():
    """The INS: simulator, tape, dead reckoning, and filters by all rules on every kind of sensor."""
    r = ins_lanes.made(seed=1, duration=4.2, samples_per_step=13, fix_period=1.0, dvl_period=0.5)
    model = r.model.replace(sensors=r.model.sensors | {"heading": AidingModel("heading", 0.05)})
    heading = Aiding(r.step_time, r.truth[:, 8])
    dvl = r.aiding["dvl"]
    lost = Aiding(dvl.time, dvl.values, np.arange(len(dvl)) >= 4)
    r = dataclasses.replace(
        r, model=model, aiding=dict(r.aiding) | {"heading": heading, "dvl": lost},
        noise_scales=dict(r.noise_scales) | {"heading": np.ones(len(heading))},
    )  # fmt: skip
    batch, count, found = InsBatch.of([r]), len(r), {"angle": r.angle}
    for name, chosen in CATALOGUE.items():
        for fill in (0, 1, 2) if name == "ins_kf" else (0,):
            run = ins_estimation.run(
                chosen, batch, chosen.space.array({"fill": fill})[None], 5, True
            )
            found |= {f"{name} {fill} {what}": getattr(run, what) for what in ("states", "covariances", "nis")}  # fmt: skip
    found["smoothed"] = navgym.smooth("ins_kf", r).states
    place, v, C = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3, 3))
    start = batch.models["start"][0]
    mechanise(
        np.array(r.angle), np.array(r.velocity), r.interval, start[:3].copy(), start[3:6].copy(),
        start[6:].reshape(3, 3).copy(), place, v, C,
    )  # fmt: skip
    return found | {"place": place, "v": v}


def identification():
    """The relevance vector machine on a curve and noise."""
    x = np.linspace(0.0, 6.0, 24)
    y = np.sin(x) / (1.0 + x) + 0.05 * np.random.default_rng(4).standard_normal(24)
    machine = navgym.identification.RVM(scale=1.0).fit(x, y)
    # early steps follow ill-conditioned factors: only the last ones have all digits
    return {
        "weights": machine.weights, "covariance": machine.covariance,
        "iterations": machine.iterations, "evidence": machine.trace[-10:],
    }  # fmt: skip


def environments():
    """Both environments, single and in a batch."""
    found = {}
    for name, scenario, overrides in (
        ("AUVDropout", "auv/switch-D", {"steps": 20, "loss": 0.3}),
        ("DeckDeformation", "deck/paper", {"duration": 0.9}),
        ("INSDropout", "ins/outage", {"duration": 3.2}),
    ):
        own = (
            {"reward": "relative"}
            if "auv" in scenario
            else {"warmup": 0.4 if "ins" in scenario else 0.3}
        )
        options = {"scenario": scenario, "overrides": overrides, "decision_interval": 4} | own
        one = gymnasium.make(f"navgym/{name}-v0", **options)
        two = gymnasium.make_vec(f"navgym/{name}-v0", num_envs=2, **options)
        for env, face in ((one, "single"), (two, "batch")):
            obs, _ = env.reset(seed=7)
            action = np.full(env.action_space.shape, 0.3, np.float32)
            found[f"{name} {face}"] = np.array([obs, *(env.step(action)[0] for _ in range(2))])
            found[f"{name} {face} reward"] = env.step(-action)[1]
            env.close()
        table = one.unwrapped.engine.table
        found[f"{name} rows"] = np.zeros((1, len(one.unwrapped.engine.space)))
        fill_rows(found[f"{name} rows"], np.full((1, len(table)), -0.2), table)
    return found


def live_auv():
    """The AUV's live lane."""
    recording = navgym.simulate("auv/switch-D", seed=4, steps=6, loss=0.3)
    lane = LiveAUV(AUVDropoutSettings(), {}, recording.model)
    seen = []
    for y, lost in zip(recording.measurements, recording.lost, strict=True):
        lane.put(np.where(lost, np.nan, y))
        lane.step(look=True)
        seen.append(np.concatenate([lane.observation[0], lane.answer(0)[0], lane.tally]))
    bank = navgym.LiveBank(sometimes_apart)
    times = np.array([1.0, 2.0, 3.0, 3.5, 4.5, 5.0])
    rows = zip(recording.measurements, recording.lost, times.tolist(), strict=True)
    told = [bank.step(y, lost, time) for y, lost, time in rows]
    return {"seen": seen, "bank": [e.state for e in told]}


def sometimes_apart(step):
    """A model whose axes are alike over steps of a second, and not over others."""
    R = np.eye(4) if step == 1.0 else np.diag([1.0, 1.0, 2.0, 1.0])
    return navgym.LinearModel(dt=step, R=R)


def live_deck():
    """The deck's live lane."""
    r = navgym.simulate("deck/paper", seed=4, duration=0.3)
    lane = LiveDeck(DeckDeformationSettings(), {}, r.model, r.interval)
    seen = []
    for sample in zip(r.main_angle, r.main_velocity, r.sub_angle, r.sub_velocity, strict=True):
        lane.put(sample)
        if lane.ready():
            lane.step(look=True)
            seen.append(np.concatenate([lane.observation[0], lane.answer(0)[0], lane.tally]))
    return {"seen": seen}


def live_ins():
    """The INS's live lane."""
    r = navgym.simulate("ins/nominal", seed=4, duration=1.2)
    lane, seen = LiveINS(INSDropoutSettings(), {}, r.model, r.interval), []
    for sample, time, _ in lane.samples(r):
        lane.put(sample, None, time)
        if lane.ready():
            lane.step(look=True)
            seen.append(np.concatenate([lane.observation[0], lane.answer(0)[0], lane.tally]))
    return {"seen": seen}


def declared():
    """(file, name) of every function that one of the three decorators marks."""
    return {
        (str(path), node.name)
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
        and {"kernel", "part", "inline"} & {getattr(d, "id", "") for d in node.decorator_list}
    }


def main():
    """Write `numbers` and the names of the kernels that were not run."""
    assert os.environ["NUMBA_DISABLE_JIT"] == "1"
    ran = set()

    if sys.gettrace() is None:  # else a debugger or coverage is watching
        sys.settrace(lambda frame, *_: ran.add(frame.f_code))
    found = numbers()
    missing = declared() - {(inspect.getfile(code), code.co_name) for code in ran.copy()}
    np.savez(sys.argv[1], missing=sorted(f"{Path(f).name}: {name}" for f, name in missing), **found)


if __name__ == "__main__":
    main()
