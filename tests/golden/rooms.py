"""What the golden outputs are of. All imports from navgym stand here: a move changes these lines.

A room is a function that yields (key, array). Recordings are short, seeds fixed; what a filter, an
environment or a reader is given is the same on every run.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium
import numpy as np
from scipy.spatial.transform import Rotation

import navgym
from navgym import agents, metrics
from navgym.agents.live.fallback import FallbackRule
from navgym.identification import METHODS
from navgym.problem import REGISTERED

Entries = Iterator[tuple[str, Any]]
AUV, DECK = "navgym/AUVDropout-v0", "navgym/DeckDeformation-v0"
SAMPLES = 80  # of an AUV's recording
SECONDS = 20.0  # of a deck's
ESTIMATED = (
    "states", "covariances", "innovations", "innovation_variance", "weights", "nis",
    "log_likelihood", "attitude", "static", "attitude_error", "unobserved",
)  # fmt: skip
RECORDED = (
    "time", "measurements", "lost", "truth", "process_scale", "measurement_scale", "regime",
    "main_angle", "main_velocity", "sub_angle", "sub_velocity", "theta", "theta_rate", "static",
    "attitude", "disturbance", "impulse_variance", "disturbance_variance", "reference",
)  # fmt: skip
IDENTIFIED = ("stiffness", "damping", "sigma", "deviation", "evidence")


def recording_of(scenario: str, **changes: Any) -> Any:
    """A short recording of a scenario."""
    size = {"steps": SAMPLES} if scenario.startswith("auv/") else {"duration": SECONDS}
    return navgym.simulate(scenario, seed=1, **size | changes)


def scenario_names() -> list[str]:
    """Those that come with navgym."""
    own = {n for n, r in REGISTERED.items() if r.problem.startswith(f"{navgym.__name__}.")}
    return [name for name in navgym.scenarios() if name.partition("/")[0] in own]


def attributes(key: str, thing: Any, names: tuple[str, ...]) -> Entries:
    """Those of the named attributes that `thing` has."""
    for name in names:
        value = getattr(thing, name, None)
        if value is not None:
            yield f"{key}/{name}", value


# ---- scenarios and filters


def scenarios() -> Entries:
    """What is simulated; where this changes, everything below does."""
    for scenario in scenario_names():
        yield from attributes(f"scenario/{scenario}", recording_of(scenario), RECORDED)


def filters() -> Entries:
    """Every filter on every scenario that it takes."""
    for scenario in scenario_names():
        recording, diverged = recording_of(scenario), []
        for name in sorted(navgym.filters()):
            try:
                found = navgym.estimate(name, recording)
            except ValueError:  # made for recordings or models of another kind
                continue
            diverged.append(found.diverged)
            yield from estimated(f"filter/{scenario}/{name}", found)
        yield f"filter/{scenario}/diverged", diverged
    yield from scheduled()
    yield from identifying()


def estimated(key: str, found: Any) -> Entries:
    """What a filter says."""
    yield from attributes(key, found, ESTIMATED)
    for name, value in found.extras.items():
        if not hasattr(found, name):
            yield f"{key}/{name}", value


def scheduled() -> Entries:
    """Parameters that are not the defaults, and that change on the way."""
    tuned = {"process_noise_scale": [1.0, 70.0, 10.0], "forgetting": 0.9, "vb_iterations": 3}
    found = navgym.estimate("qivbf", recording_of("auv/switch-B"), tuned)
    yield from estimated("filter/scheduled/qivbf", found)
    widths = {"kernel_width": [20.0, 2.0, 5.0], "process_noise_scale": 3.0}
    found = navgym.estimate("alignment_mcc", recording_of("deck/glitch"), widths)
    yield from estimated("filter/scheduled/alignment_mcc", found)


def identifying() -> Entries:
    """The deck filters that identify the flexure, for as long as it takes them to."""
    recording = recording_of("deck/sea-state", duration=150.0)
    for name in ("idam", "idam_printed", "svram", "woam"):
        tuned = {"identification_window": 60.0}
        if name == "idam":
            tuned["model_error_weight"] = 10.0  # model prediction on
        found = navgym.estimate(name, recording, tuned)
        key = f"filter/identifying/{name}"
        yield from attributes(key, found, ("states", "covariances", "model_error", "attitude"))
        for i, at in enumerate(found.flexures):
            yield f"{key}/{i}/step", at.step
            yield from attributes(f"{key}/{i}", at.model, IDENTIFIED)


# ---- environments

# arguments by id; an environment that is registered without any is rolled out as it comes
SINGLE: Mapping[str, Mapping[str, Any]] = {
    AUV: {"scenario": "auv/switch-D", "overrides": {"steps": 100}},
    DECK: {"scenario": "deck/switch-60", "overrides": {"duration": 12.0}},
}
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    AUV: {"scenario": "auv/switch-B", "action": "residual", "reward": "relative",
          "action_parameters": ("process_noise_scale", "forgetting")},
    DECK: {"scenario": "deck/glitch", "action": "residual", "features": "gyro"},
}  # fmt: skip


def environment_ids() -> list[str]:
    """Those that come with navgym; tests register more."""
    return sorted(
        r.environment for r in REGISTERED.values() if r.problem.startswith(f"{navgym.__name__}.")
    )


def environments() -> Entries:
    """Roll-outs of fixed actions on the three faces of each environment."""
    for name in environment_ids():
        known = dict(SINGLE.get(name, {}))
        yield from single(f"environment/{name}/single", name, known)
        yield from single(f"environment/{name}/variant", name, known | dict(VARIANTS.get(name, {})))
        yield from batch(f"environment/{name}/batch", name, known)
        yield from stable_baselines(f"environment/{name}/sb3", name, known)


def actions(shape: tuple[int, ...]) -> Any:
    """Actions in [-1, 1], (30, ...): enough to see the end of an episode."""
    return np.random.default_rng(5).uniform(-1.0, 1.0, (30, *shape)).astype(np.float32)


def single(key: str, name: str, arguments: Mapping[str, Any]) -> Entries:
    """An episode of one environment; its info field by field."""
    env = gymnasium.make(name, **arguments)
    seen: list[Any] = [(env.reset(seed=7)[0], 0.0, False, False, {})]
    for action in actions(env.action_space.shape or ()):
        seen.append(env.step(action))
        if seen[-1][2] or seen[-1][3]:
            break
    observations, rewards, terminated, truncated, infos = zip(*seen, strict=True)
    yield f"{key}/observations", np.array(observations)
    yield f"{key}/rewards", rewards
    yield f"{key}/ends", np.array([terminated, truncated])
    for field in infos[-1]:
        yield f"{key}/info/{field}", [float(info[field]) for info in infos[1:]]


def batch(key: str, name: str, arguments: Mapping[str, Any]) -> Entries:
    """Three lanes of the native batch, beyond the end of the first episodes."""
    envs = gymnasium.make_vec(name, num_envs=3, **arguments)
    seen = [(envs.reset(seed=11)[0], np.zeros(3), np.zeros(3, bool), np.zeros(3, bool))]
    seen += [envs.step(chosen)[:4] for chosen in actions(envs.action_space.shape or ())]
    observations, rewards, terminated, truncated = (np.array(v) for v in zip(*seen, strict=True))
    yield f"{key}/observations", observations
    yield f"{key}/rewards", rewards
    yield f"{key}/ends", np.array([terminated, truncated])


def stable_baselines(key: str, name: str, arguments: Mapping[str, Any]) -> Entries:
    """Three lanes as Stable-Baselines3 sees them, begun at places of their own."""
    from navgym.agents.training.vec_env import lane_vec_env

    envs = lane_vec_env(name, 3, desynchronise=True, **arguments)
    envs.seed(13)
    first = envs.reset()
    seen = [envs.step(chosen)[:3] for chosen in actions((3, *(envs.action_space.shape or ())))]
    observations, rewards, ends = (np.array(v) for v in zip(*seen, strict=True))
    yield f"{key}/observations", np.concatenate([first[None], observations])
    yield f"{key}/rewards", rewards
    yield f"{key}/ends", ends


# ---- what has been learned


# what live filters are fed: losses such as no policy has seen; a deck's warm-up takes 60 s
LIVE = {
    "qivbf": ("auv/switch-D", {"steps": 200, "loss": 0.95}),
    "idam": ("deck/switch-60", {"duration": 90.0}),
}
RULES = {
    "usual": FallbackRule(),
    "wary": FallbackRule(margin=9.0, window=3, confidence=0.5, advantage=0.0, recovery=3),
    "trusting": None,
}


def learned() -> Entries:
    """Live filters by shipped policies, and the shipped combiner."""
    for name, (scenario, changes) in LIVE.items():
        recording = recording_of(scenario, **changes)
        policy = agents.shipped(scenario.partition("/")[0])
        looks = np.random.default_rng(3).uniform(-2.0, 2.0, (20, len(policy.low)))
        yield f"learned/{name}/actions", policy(looks.astype(np.float32))
        for rule in RULES:
            yield from followed(f"learned/{name}/{rule}", name, policy, recording, rule)
        yield from followed(f"learned/{name}/fixed", name, idle(policy), recording, "usual")
    combiner = agents.Combiner.load(Path(agents.__file__).parent / "pretrained" / "combiner")
    for scenario in ("auv/switch-D", "auv/burst"):
        found = combiner.estimate(recording_of(scenario))
        yield from estimated(f"learned/combiner/{scenario}", found)


def idle(policy: agents.Policy) -> agents.Policy:
    """A policy that leaves the parameters where the other one's residuals start."""
    shape = len(policy.manifest.action_parameters), len(policy.low)
    return agents.Policy(policy.manifest, [(np.zeros(shape), np.zeros(shape[0]))])


def followed(key: str, name: str, policy: agents.Policy, recording: Any, rule: str) -> Entries:
    """A live filter over a recording; why it fell back is a text, so only that it did."""
    interval = float(recording.time[1] - recording.time[0])
    live = agents.SelfTuningFilter(
        name, policy, recording.model, interval=interval, rule=RULES[rule]
    )
    seen = list(live.follow(recording))
    for name in ("state", "covariance", "nis"):
        yield f"{key}/{name}", np.array([getattr(s, name) for s in seen])
    rows = [[v for v in s.parameters.values() if not isinstance(v, str)] for s in seen]
    yield f"{key}/parameters", np.array(rows, dtype=float)
    yield f"{key}/fallback", [s.fallback is not None for s in seen]
    yield f"{key}/counts", [live.decisions, live.fallbacks, live.fallback_decisions, live.restarts]


# ---- studies and trainings


def studies() -> Entries:
    """Two small studies, from the first trial to the report."""
    from navgym.tuning import tune
    from navgym.tuning.settings import StudySettings

    asked: Mapping[str, Mapping[str, Any]] = {
        "auv": {"filter": "qivbf", "trials": 24, "runs": 4, "select_runs": 3, "report_runs": 4,
                "steps": SAMPLES},
        "deck": {"filter": "alignment_mcc", "scenario": ("deck/switch-30",), "trials": 6, "runs": 2,
                 "select_runs": 2, "report_runs": 2, "overrides": {"duration": 70.0}},
    }  # fmt: skip
    for name, given in asked.items():
        with tempfile.TemporaryDirectory() as folder:
            found = tune.run(StudySettings(out=Path(folder), workers=1, **given))
        yield from study(f"study/{name}", found)


def study(key: str, found: Any) -> Entries:
    """Trials, the winner, what surrounds it, and the comparison with others."""
    trials = found.outcome.trials
    problem = key.rpartition("/")[2]
    space = navgym.parameter_space(found.settings.filter, problem)
    yield f"{key}/values", np.array([space.array(t.values) for t in trials])
    yield f"{key}/results", [t.result for t in trials]
    yield f"{key}/given_up", [t.given_up for t in trials]
    yield f"{key}/chosen", [found.chosen.number, found.chosen.result]
    yield f"{key}/sweeps", np.concatenate([s.change for s in found.sweeps])
    yield f"{key}/importances", list(found.importances.values())
    for scenario, comparison in found.reports.items():
        for label, errors in comparison.errors.items():
            yield f"{key}/{scenario}/{label.replace(', ', '-').replace(' ', '-')}", errors


def trainings() -> Entries:
    """A tiny training of each environment: the policy that it ends with, and what it was worth."""
    from navgym.agents.training.configuration import Configuration, Recipe
    from navgym.agents.training.run import train

    recipe = Recipe(hidden=(16, 16), steps=32, batch=64, epochs=2)
    small: dict[str, Any] = {
        "pool": 4,
        "validation": 2,
        "lanes": 8,
        "decisions": 1500,
        "interval": 800,
    }
    asked: Mapping[str, dict[str, Any]] = {
        "auv": {"overrides": {"steps": 100}},
        "deck": {"environment": DECK, "scenarios": ("deck/switch-30",), "reward": "composite",
                 "overrides": {"duration": 70.0}, "action_parameters": ("kernel_width",)},
    }  # fmt: skip
    for name, given in asked.items():
        with tempfile.TemporaryDirectory() as folder:
            config = Configuration(recipe=recipe, out=Path(folder), **small | given)
            made = train(config, report=lambda _line: None)
        yield f"training/{name}/scores", [mark.score for mark in made.history]
        assert made.policy is not None
        for part, array in made.policy.parts()[1].items():
            yield f"training/{name}/{part}", array


# ---- readers


def readers() -> Entries:
    """Every format of `navgym.read`, on small files that are made here."""
    with tempfile.TemporaryDirectory() as folder:
        for name, (write, options) in FORMATS.items():
            own = Path(folder) / name
            own.mkdir()
            recording = navgym.read(name, write(own), **options)
            yield from attributes(f"reader/{name}", recording, RECORDED)
            model = recording.model
            for field in ("F", "H", "Q", "R", "x0", "P0", "lever_arm"):
                yield from attributes(f"reader/{name}/model", model, (field,))


def table(path: Path, head: str, columns: Any, delimiter: str = ",") -> Path:
    """Write columns below a header; NaN is an empty cell."""
    rows = np.column_stack(columns).tolist()
    text = [delimiter.join("" if v != v else repr(v) for v in row) for row in rows]
    path.write_text("\n".join([head, *text]) + "\n")
    return path


def csv_log(folder: Path) -> Path:
    """An AUV's own log at uneven times, with lost cells and a truth."""
    rng = np.random.default_rng(21)
    time = np.cumsum(rng.uniform(0.5, 1.5, 40))
    y = np.column_stack([2.0 * time, np.full(40, 2.0), -time, np.full(40, -1.0)])
    sensed = np.where(rng.random((40, 4)) < 0.2, np.nan, y + rng.uniform(-1.0, 1.0, (40, 4)))
    names = ("px", "vx", "py", "vy")
    head = ",".join(["time", *names, *(f"truth_{n}" for n in names)])
    return table(folder / "log.csv", head, [time, sensed, y])


def akit(folder: Path) -> Path:
    """A track of A-KIT: a slow turn from the harbour of Haifa."""
    time = np.arange(40.0)
    yaw = 0.02 * time
    north, east = 40.0 * np.sin(yaw) / 6.4e6, 40.0 * (1.0 - np.cos(yaw)) / 5.4e6
    level = np.column_stack([np.full(40, -10.0), np.cos(yaw), np.sin(yaw), np.zeros((40, 3)), yaw])
    gt = (
        "Time [s],Longitude [rad],Latitude [rad],Altitude [m],V North [m/s],V East [m/s],"
        "V Down [m/s],Roll [rad],Pitch [rad],Yaw [rad]"
    )
    dvl = "Time [s],DVL X [m/s],DVL Y [m/s],DVL Z [m/s]"
    table(folder / "GT_trajectory1.csv", gt, [time, 0.6089 + east, 0.5733 + north, level])
    body = [0.98 + 0.01 * np.sin(time), 0.02 * np.cos(time), np.zeros(40)]
    table(folder / "DVL_trajectory1.csv", dvl, [time, *body])
    return folder


def deck_csv(folder: Path) -> Path:
    """A ship's log of two IMUs, written from a simulated recording; a sample is lost."""
    recording = recording_of("deck/paper", duration=5.0)
    units = [
        np.array(getattr(recording, f"{unit}_{kind}")) / recording.interval
        for unit in ("main", "sub")
        for kind in ("angle", "velocity")
    ]
    units[2][50] = np.nan
    sensors = [
        f"{unit}_{s}_{a}" for unit in ("main", "sub") for s in ("gyro", "acc") for a in "xyz"
    ]
    head = ",".join(["time", *sensors, "qx", "qy", "qz", "qw"])
    return table(folder / "ship.csv", head, [recording.time, *units, recording.reference])


def repoimu(folder: Path) -> Path:
    """Two segments of a pendulum that swings about z, samples of the second 2 ms later."""
    head = (
        "Time (s);Vicon Orientation;;;;IMU Acceleration;;;IMU Gyroscope;;;IMU Magnetometer;;;\n"
        ";W;X;Y;Z;X;Y;Z;X;Y;Z;X;Y;Z;"
    )
    for number, (size, speed) in enumerate(((0.5, 4.2), (0.8, 4.4)), start=1):
        time = 0.6 + np.arange(0.0, 8.0, 0.00625) + 0.002 * (number - 1)
        about = np.zeros((2, len(time), 3))
        about[:, :, 2] = size * np.sin(speed * time), size * speed * np.cos(speed * time)
        attitude = Rotation.from_rotvec(about[0])
        mount = Rotation.from_euler("ZYX", [150.0 - 20.0 * number, 3.0, -2.0], degrees=True)
        gyro = mount.apply(about[1], inverse=True) + 0.01
        force, field = (
            mount.apply(attitude.apply(v, inverse=True), inverse=True)
            for v in (np.array([0.0, 9.81, 0.0]), np.array([0.6, -0.8, 0.0]))
        )
        path = folder / f"Pendulum_Made_Trial1_Segment_{number}.csv"
        q = attitude.as_quat(scalar_first=True)
        table(path, head, [time, q, force, gyro, field], delimiter=";")
    return folder


def multi_imu(folder: Path) -> Path:
    """Two IMUs fixed to a quadrotor, the second turned by 2° and 20 ms late."""
    time = np.arange(600) / 120.0
    head = "time,Euler_X,Euler_Y,Euler_Z,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"
    for number, late in ((1, 0.0), (2, 0.02)):
        at = time - late
        rate = np.stack([np.sin(3 * at), np.cos(2 * at), np.sin(5 * at + 1)], axis=-1)
        mount = Rotation.from_rotvec(np.array([1.0, -2.0, 0.5]) * (number - 1), degrees=True)
        gyro = np.degrees(mount.apply(rate, inverse=True))
        force = mount.apply(np.tile([0.0, 0.0, 9.81], (600, 1)), inverse=True)
        table(folder / f"path_1_IMU_{number}.csv", head, [time, np.zeros((600, 3)), force, gyro])
    return folder


FORMATS: Mapping[str, tuple[Callable[[Path], Path], Mapping[str, Any]]] = {
    "csv": (csv_log, {"position_noise": 1.5}),
    "akit": (akit, {"loss": 0.3, "seed": 1}),
    "deck_csv": (deck_csv, {"gyro_unit": "rad/s", "lever_arm": (10.0, 10.0, 2.0)}),
    "repoimu": (repoimu, {"trial": "Made_Trial1"}),
    "multi_imu": (multi_imu, {}),
}


# ---- identification and metrics


def methods() -> Entries:
    """Every way to identify the flexure, on one record; bounds and measures of one estimate."""
    recording = recording_of("deck/paper", duration=60.0)
    increments = navgym.flexure_increments(recording)
    yield "method/increments", increments
    for name in METHODS:
        found = navgym.identify(name, increments, recording.step)
        yield from attributes(f"method/{name}", found, IDENTIFIED)
        yield f"method/{name}/smoothed", found.diagnostics["smoothed"]
        yield f"method/{name}/residual", found.diagnostics["residual"]
    yield from bounds(recording_of("auv/nominal").model)
    yield from judged()


def bounds(model: Any) -> Entries:
    """What no filter can beat."""
    for label, found in (
        ("steady_state", metrics.steady_state(model)),
        ("loss_bounds", metrics.loss_bounds(model, 0.7)),
    ):
        for name, value in asdict(found).items():
            yield f"method/bounds/{label}/{name}", value
    yield "method/bounds/critical_arrival_rate", metrics.critical_arrival_rate(model)


def judged() -> Entries:
    """Errors, consistency and a comparison of two filters."""
    recordings = [navgym.simulate("auv/switch-D", seed, SAMPLES) for seed in range(8)]
    errors = {}
    for name in ("kf", "bank"):
        found = [navgym.estimate(name, r) for r in recordings]
        pairs = list(zip(found, recordings, strict=True))
        squared = [metrics.squared_error(e.states, r.truth, r.model.position) for e, r in pairs]
        errors[name] = metrics.run_rmse(squared)
        yield f"method/metrics/{name}/time_rmse", metrics.time_rmse(squared)
        yield from numbers(f"method/metrics/{name}/summary", metrics.summarize(squared))
        dof = [metrics.degrees_of_freedom(r.lost) for r in recordings]
        judgement = metrics.consistency([e.nis for e in found], dof)
        yield from numbers(f"method/metrics/{name}/consistency", judgement)
        nees = [metrics.nees(e.states, e.covariances, r.truth) for e, r in pairs]
        yield f"method/metrics/{name}/nees", nees
    difference = metrics.paired_difference(errors["bank"], errors["kf"], resamples=500)
    yield from numbers("method/metrics/difference", difference)


def numbers(key: str, thing: Any) -> Entries:
    """Fields of a dataclass that are numbers."""
    assert is_dataclass(thing) and not isinstance(thing, type)  # noqa: PT018
    for name, value in asdict(thing).items():
        yield f"{key}/{name}", np.asarray(value, dtype=float)


# by the word that its keys begin with, which also names its file
ROOMS: Mapping[str, Callable[[], Entries]] = MappingProxyType(
    {
        "scenario": scenarios,
        "filter": filters,
        "environment": environments,
        "learned": learned,
        "study": studies,
        "training": trainings,
        "reader": readers,
        "method": methods,
    }
)


def entries(room: str) -> Entries:
    """A room's keys and arrays; what the user is warned of on the way is of no interest here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield from ROOMS[room]()
