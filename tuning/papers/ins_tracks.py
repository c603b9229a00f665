"""INS/DVL on A-KIT's tracks: dead reckoning, outages of the log, and position fixes beside filters of four states.

There are six tracks, so intervals resample tracks: a track's figure is the mean over its seeds.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation
from tqdm import tqdm

import navgym
from navgym.auv.problem import PROBLEM as AUV
from navgym.core.checks import Array
from navgym.ins.akit import read_akit_ins
from navgym.ins.problem import PROBLEM, TRACKS
from navgym.ins.recording import Aiding, InertialRecording
from navgym.ins.settings import SETTLED
from navgym.metrics import paired_difference
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.models import LinearModel
from navgym.statespace.recording import Recording
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Entry
from navgym.tuning.papers import expected_ins as expected
from navgym.tuning.papers.amounts import InsReproductionAmount
from navgym.tuning.papers.dead_reckoning import dead_reckon
from navgym.tuning.papers.expected import Check
from navgym.tuning.papers.ins_tables import R10, gained, hold
from navgym.tuning.papers.part import KEY, Part, check_table
from navgym.tuning.report.page import Section, Table

TUNED_ON, NUMBERS = TRACKS.folds[0], TRACKS.numbers
POSITION_NOISE = 1.0  # m, of a fix
START_STREAM, LOSS_STREAM = 0xE2, 0xE3  # first words of seed sequences
RUNAWAY = 100.0  # m: on tracks of 700 m


def has_inertial_data(folder: Path) -> bool:
    """Whether a folder of tracks holds those that today's repository lacks."""
    return any(folder.glob("**/IMU_trajectory*.csv"))


def per_track(each: Array, recordings: Sequence[Any]) -> Array:
    """(6,) mean over the recordings of each track."""
    tracks = np.array([r.meta["track"] for r in recordings])
    return np.array([each[tracks == t].mean() for t in np.unique(tracks)])


def _seeds(split: str, count: int) -> range:
    return navgym.seeds(split, count)


# ---- without fixes

RECKONED = (
    Entry("KF", "ins_kf"), Entry("KF, R×10", "ins_kf", R10), Entry("Student", "ins_student"), Entry("VB", "ins_vb"),
    Entry("bank", "ins_bank"),
)  # fmt: skip


def reckoning(folder: Path) -> Part:
    """Recorded IMU, Doppler log and depth, nothing else: end error, and heading."""
    recordings = [read_akit_ins(folder, track=t, seed=_seeds("test", 1)[0]) for t in NUMBERS]
    cases = Cases.of(recordings)
    rows, found = [], {}
    for entry in RECKONED:
        states = PROBLEM.run(entry.filter, cases.batch, entry.parameters).states
        ends, headings = np.transpose([_end(r, s) for r, s in zip(recordings, states, strict=True)])
        found[entry.label] = {"end, % of distance": ends.tolist(), "heading, °": headings.tolist()}
        rows.append([entry.label, *(f"{e:.2f}" for e in ends), f"**{np.median(ends):.2f}**", f"{np.median(headings):.2f}"])  # fmt: skip
    own = found["KF"]
    values = [("end error, % of the distance", expected.END, own["end, % of distance"]), ("heading, rms, °", expected.HEADING, own["heading, °"])]  # fmt: skip
    checks = [
        Check(f"median {what}", value, float(np.median(each)), float(np.ptp(each)) / 2.0, 0.0, smaller_is_fine=True)
        for what, value, each in values
    ]  # fmt: skip
    head = ["end error, % of distance", *map(str, NUMBERS), "median", "heading, rms, °"]
    text = ["Tracks 1-6, clocks brought together, filter started from the reference, defaults. The prototype had 13 tracks, of which six have inertial data here."]  # fmt: skip
    section = Section("Real tracks: dead reckoning", text, [Table(head, rows), check_table(checks)])
    return Part(section, tuple(checks), found)


def _end(recording: InertialRecording, states: Array) -> tuple[float, float]:
    """End error in % of the distance, and rms of the heading, °."""
    truth = np.asarray(recording.truth)
    known = np.isfinite(truth[:, 0])
    true = truth[known]
    e = states[: len(truth)][known, :9] - true[:, :9]
    distance = float(np.hypot(*np.diff(true[:, :2], axis=0).T).sum())
    heading = np.degrees((e[:, 8] + np.pi) % (2.0 * np.pi) - np.pi)
    return 100.0 * float(np.hypot(e[-1, 0], e[-1, 1])) / distance, float(np.sqrt(np.mean(heading**2)))  # fmt: skip


# ---- outages

BEGIN = 120.0  # s, of an outage
STAND_INS = (
    Entry("KF", "ins_kf"), Entry("KF, R×10", "ins_kf", R10), Entry("hold, .1 + .003/s", "ins_kf", hold(0.1, 0.003)),
    Entry("hold, .3 + .03/s", "ins_kf", hold(0.3, 0.03)), Entry("hold, 1 + .01/s", "ins_kf", hold(1.0, 0.01)),
    Entry("hold until 15°", "ins_kf", hold(0.1, 0.03, fill_turn_limit=15.0)),
    Entry("Student", "ins_student"), Entry("MCC", "ins_mcc"), Entry("VB", "ins_vb"), Entry("bank", "ins_bank"),
)  # fmt: skip


def outages(size: InsReproductionAmount, folder: Path) -> Part:
    """The log lost for one and two minutes, as recorded and with MEMS errors added."""
    each: dict[str, Array] = {}
    checks, worst = [], []
    for j, (kind, errors) in enumerate((("as recorded", None), ("MEMS errors", "mems"))):
        read = _recorded(folder, errors, _seeds("test", size.draws if errors else 1))
        for length, values in expected.OUTAGES.items():
            cases = Cases.of([silent(r, BEGIN, float(length)) for r in read])
            name = f"{length} s, {kind}"
            for entry in STAND_INS:
                found, _ = cases.errors(entry.filter, entry.parameters)
                worst.append(float(found.max()))
                each[f"{name}: {entry.label}"] = per_track(found, read)
            checks += [
                Check(f"{name}: {x}, m", v[j], *_median(each[f"{name}: {x}"]), 0.0, smaller_is_fine=True) for x, v in values.items()
            ]  # fmt: skip
    section = Section("Real tracks: the log lost", [_outage_text(max(worst), size.draws)], [_outage_table(each), check_table(checks)])  # fmt: skip
    done = {k: v.tolist() for k, v in each.items()} | {"worst": max(worst)}
    return Part(section, tuple(checks), done)


def _recorded(folder: Path, errors: str | None, seeds: range) -> list[InertialRecording]:
    pairs = [(t, s) for t in NUMBERS for s in seeds]
    return [
        read_akit_ins(folder, track=t, seed=s, imu_errors=errors)
        for t, s in tqdm(pairs, desc=f"tracks, {errors or 'as recorded'}")
    ]


def _outage_table(each: Mapping[str, Array]) -> Table:
    names = list(dict.fromkeys(key.split(":")[0] for key in each))
    rows = [
        [e.label, *(_outage_cell(each[f"{n}: {e.label}"], each[f"{n}: KF"], e.label) for n in names)] for e in STAND_INS
    ]  # fmt: skip
    caption = "Horizontal rms after 60 s, m: median of the six tracks' means; then the gain over KF in the mean, with an interval that resamples tracks. " + KEY  # fmt: skip
    return Table(["filter", *names], rows, caption)


def _outage_text(worst: float, draws: int) -> str:
    told = "Nothing runs away with the shipped defaults" if worst < RUNAWAY else "**Some filter runs away**"  # fmt: skip
    return f"The log is silent from {BEGIN:.0f} s on. {told}: the worst of all runs has {worst:.1f} m rms. {draws} seeds of added errors per track."  # fmt: skip


def _median(each: Array) -> tuple[float, float]:
    """Median of the tracks, and half of what lies between their quartiles."""
    low, high = np.quantile(each, [0.25, 0.75])
    return float(np.median(each)), float(high - low) / 2.0


def _outage_cell(own: Array, plain: Array, label: str) -> str:
    told = "" if label == "KF" else f"; {gained(paired_difference(own, plain))}"
    return f"{np.median(own):.2f}{told}"


def silent(recording: InertialRecording, begin: float, length: float) -> InertialRecording:
    """The same with the Doppler log lost from `begin` s on, for `length` s."""
    dvl = recording.aiding["dvl"]
    after = dvl.time - (recording.time[0] - recording.interval)
    lost = dvl.lost | ((after >= begin) & (after < begin + length))
    aiding = dict(recording.aiding) | {"dvl": Aiding(dvl.time, np.array(dvl.values), lost)}
    return dataclasses.replace(recording, aiding=aiding, check_units=False)


# ---- with fixes, beside filters of four states

SCALES = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)  # of the log's R, to choose among
# m²/s, of the dead reckoning's velocity error where the log is heard and where it is lost, likewise
DENSITIES = tuple(itertools.product((1e-4, 3e-4, 1e-3, 3e-3), (0.01, 0.03, 0.1, 0.3)))
CHOSEN = ("ins_kf", "ins_student", "ins_vb", "ins_bank")
FOUR = ("kf", "imm", "bank")
RECKON = "dead reckoning"


@dataclasses.dataclass(frozen=True, eq=False)
class Both:
    """The same fixes and velocities for both kinds of filter.

    Args:
        cases: for INS filters.
        plain: for filters of position and velocity.
        moves: per recording (K, 2) m north and east between two fixes, by the log's held body velocity.
    """

    cases: Cases
    plain: tuple[Recording, ...]
    moves: tuple[Array, ...]

    @classmethod
    def of(cls, recordings: Sequence[InertialRecording], rate: float) -> Both:
        """Fixes and velocities of `recordings`, each lost at `rate` on its own; starts off by 1 m."""
        own, plain, moves = zip(*(both(lossy(r, rate)) for r in recordings), strict=True)
        return cls(Cases.of(own), plain, moves)


def with_fixes(folder: Path, seeds: range, tracks: Sequence[int]) -> list[InertialRecording]:
    """Tracks with fixes of 1 m at 1 Hz, nothing lost."""
    pairs = [(t, s) for t in tracks for s in seeds]
    return [
        read_akit_ins(folder, track=t, seed=s, position_noise=POSITION_NOISE)
        for t, s in tqdm(pairs, desc="tracks with fixes")
    ]


def lossy(recording: InertialRecording, rate: float) -> InertialRecording:
    """The same with velocities and fixes lost at `rate`, each on its own, by the recording's track and seed."""
    rng = np.random.default_rng([LOSS_STREAM, recording.meta["track"], recording.meta["seed"]])
    aiding = dict(recording.aiding)
    for name in ("dvl", "fix"):
        sensor = aiding[name]
        lost = rng.random(len(sensor)) < rate
        aiding[name] = Aiding(sensor.time, np.array(sensor.values), sensor.lost | lost)
    return dataclasses.replace(recording, aiding=aiding, check_units=False)


def both(r: InertialRecording) -> tuple[InertialRecording, Recording, Array]:
    """A track for an INS filter, the same for one of four states, and what the log says of each interval.

    Filters of four states are given velocities turned by the *reference's* attitude, as the AUV half's reader
    does; INS filters are not. Both start off by 1 m and know it.
    """
    rng = np.random.default_rng([START_STREAM, r.meta["track"], r.meta["seed"]])
    off, metres = rng.standard_normal(2), _metres_per_radian(r)
    model = r.model.replace(
        position_deviation=POSITION_NOISE, latitude=r.model.latitude + off[0] / metres[0],
        longitude=r.model.longitude + off[1] / metres[1],
    )  # fmt: skip
    known = np.isfinite(np.asarray(r.truth)[:, 0])
    t, truth = r.step_time[known], np.asarray(r.truth)[known]
    fix = r.aiding["fix"]
    inside = (fix.time > t[0]) & (fix.time < t[-1])
    four = _of_four(r, inside, t, truth, off)
    moved = _moves(r.aiding["dvl"], fix.time[inside], t, truth)
    return dataclasses.replace(r, model=model, check_units=False), four, moved


def _of_four(
    r: InertialRecording, inside: NDArray[np.bool_], t: Array, truth: Array, off: Array
) -> Recording:
    """Fixes and turned velocities at the times of fixes, for filters of position and velocity."""
    fix, dvl = r.aiding["fix"], r.aiding["dvl"]
    at = fix.time[inside]
    true = np.column_stack([np.interp(at, t, truth[:, i]) for i in (0, 3, 1, 4)])
    velocity, gone = _turned(dvl, at, t, truth)
    measured = np.column_stack([fix.values[inside, 0], velocity[:, 0], fix.values[inside, 1], velocity[:, 1]])  # fmt: skip
    lost = np.column_stack([fix.lost[inside], gone, fix.lost[inside], gone])
    model = LinearModel.white_acceleration(
        float(np.median(np.diff(at))), position_noise=POSITION_NOISE, x0=true[0] + [off[0], 0.0, off[1], 0.0]
    )  # fmt: skip
    return Recording(
        time=at[1:], measurements=measured[1:], lost=lost[1:], truth=true[1:], model=model, meta={"track": r.meta["track"]}
    )  # fmt: skip


def _metres_per_radian(recording: InertialRecording) -> Array:
    metres: Array = Cases.of([recording]).batch.models[0]["metres"]
    return metres


def _attitude(at: Array, t: Array, truth: Array) -> Rotation:
    angles = [np.interp(at, t, np.unwrap(truth[:, i])) for i in (8, 7, 6)]
    return Rotation.from_euler("ZYX", np.column_stack(angles))


def _turned(dvl: Aiding, at: Array, t: Array, truth: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Velocity north and east at the times of fixes, between the log's own; and whether its nearest was lost."""
    ned = _attitude(dvl.time, t, truth).apply(np.nan_to_num(dvl.values))
    heard = ~dvl.lost
    velocity = np.column_stack([np.interp(at, dvl.time[heard], ned[heard, i]) for i in (0, 1)])
    after = np.clip(np.searchsorted(dvl.time, at), 1, len(dvl.time) - 1)
    nearest = after - (at - dvl.time[after - 1] < dvl.time[after] - at)
    return velocity, dvl.lost[nearest]


def _moves(dvl: Aiding, at: Array, t: Array, truth: Array) -> Array:
    """(K, 2) m between fixes, by body velocities turned by the heading as it goes on.

    Between two that were heard, their straight line; through a loss, the last one.
    """
    fine = t[(t >= at[0]) & (t <= at[-1])]
    v = _attitude(fine, t, truth).apply(_body_velocity(dvl, fine))[:, :2]
    way = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(fine)[:, None], axis=0)])  # fmt: skip
    along = np.column_stack([np.interp(at, fine, way[:, i]) for i in (0, 1)])
    moved: Array = np.diff(along, axis=0)
    return moved


def _body_velocity(dvl: Aiding, t: Array) -> Array:
    """(T, 3) m/s at any times."""
    heard = np.flatnonzero(~dvl.lost)
    held = heard[np.maximum(np.searchsorted(dvl.time[heard], t, "right") - 1, 0)]
    after = np.clip(np.searchsorted(dvl.time, t, "right"), 1, len(dvl.time) - 1)
    whole = ~dvl.lost[after] & ~dvl.lost[after - 1]
    line = np.column_stack([np.interp(t, dvl.time, np.nan_to_num(dvl.values[:, i])) for i in range(3)])  # fmt: skip
    return np.where(whole[:, None], line, dvl.values[held])


OWN = "ins_kf, R by fixes"


def fixes(size: InsReproductionAmount, folder: Path) -> Part:
    """Fixes of 1 m, and 10, 30, 50 % of fixes and velocities lost, beside filters of four states."""
    scales, density = _choices(size, folder)
    read = with_fixes(folder, _seeds("test", size.draws), NUMBERS)
    each = {
        f"{100 * rate:.0f} % lost": _fixed(Both.of(read, rate), scales, density)
        for rate in TRACKS.rates
    }
    best = {n: min((*FOUR, RECKON), key=lambda x: e[x].mean()) for n, e in each.items()}
    rows = [
        [label, *(_fixed_cell(e, label, best[n]) for n, e in each.items())] for label in next(iter(each.values()))
    ]  # fmt: skip
    checks = [
        Check(f"{n}: {OWN}, against dead reckoning of the AUV half, m", value, *_over_tracks(e[OWN]), 0.0, smaller_is_fine=True)
        for (n, e), value in zip(each.items(), expected.DEAD_RECKONING, strict=True)
    ]  # fmt: skip
    caption = "Horizontal rms after 60 s, m, mean of the six tracks' means (of tracks 4-6, on which nothing was chosen); then the gain over the best of the four-state filters at that rate, with an interval that resamples tracks."  # fmt: skip
    section = Section("Real tracks: fixes", _fixed_text(each, best, scales, density), [Table(["filter", *each], rows, caption), check_table(checks)])  # fmt: skip
    done = {n: {k: v.tolist() for k, v in e.items()} for n, e in each.items()}
    return Part(section, tuple(checks), done | {"scales": scales, "density": density})


def _over_tracks(each: Array) -> tuple[float, float]:
    """Mean, and half its 95 % interval over tracks."""
    half = stats.t.ppf(0.975, len(each) - 1) * each.std(ddof=1) / np.sqrt(len(each))
    return float(each.mean()), float(half)


def _fixed(
    data: Both, scales: Mapping[str, float], density: tuple[float, float]
) -> dict[str, Array]:
    """Errors by track (6,) of every filter."""
    batch, found = StateSpaceBatch.of(data.plain), {}
    for name in FOUR:
        states = AUV.run(name, batch, None).states
        found[name] = _four_errors(data, [s[: len(r.time)] for s, r in zip(states, data.plain, strict=True)])  # fmt: skip
    found[RECKON] = _four_errors(data, [s for s, _ in _reckoned(data, density)])
    for name in CHOSEN:
        for label, parameters in ((name, {}), (f"{name}, R by fixes", {"dvl_noise_scale": scales[name]})):  # fmt: skip
            errors, _ = data.cases.errors(name, parameters)
            found[label] = per_track(errors, data.cases.recordings)
    return found


def _four_errors(data: Both, states: Sequence[Array]) -> Array:
    rms = []
    for r, x in zip(data.plain, states, strict=True):
        e = x[:, [0, 2]] - np.asarray(r.truth)[:, [0, 2]]
        rms.append(np.sqrt(np.mean((e[r.time - r.time[0] >= SETTLED] ** 2).sum(axis=1))))
    return per_track(np.array(rms), data.plain)


def _reckoned(data: Both, density: tuple[float, float]) -> list[tuple[Array, float]]:
    return [dead_reckon(r, m, density) for r, m in zip(data.plain, data.moves, strict=True)]


def _choices(
    size: InsReproductionAmount, folder: Path
) -> tuple[dict[str, float], tuple[float, float]]:
    """Scale of the log's R per filter, and the dead reckoning's noise: least one-step error of fixes.

    On tracks 1-3 and training seeds; no truth enters.
    """
    read = with_fixes(folder, _seeds("train", size.train), TUNED_ON)
    data = [Both.of(read, rate) for rate in TRACKS.rates]
    scales = {}
    for name in CHOSEN:
        costs = [sum(_one_step(d, name, s) for d in data) for s in SCALES]
        scales[name] = SCALES[int(np.argmin(costs))]
    costs = [sum(float(np.mean([c for _, c in _reckoned(d, q)])) for d in data) for q in DENSITIES]
    return scales, DENSITIES[int(np.argmin(costs))]


def _one_step(data: Both, name: str, scale: float) -> float:
    found = data.cases.judge(name, {"dvl_noise_scale": scale}, ("fixes",)).quantities["fixes"]
    return float(found.mean())


def _fixed_cell(errors: Mapping[str, Array], label: str, best: str) -> str:
    own = errors[label]
    told = "" if label == best else f"; {gained(paired_difference(own, errors[best]))}"
    return f"{own.mean():.3f} ({own[len(TUNED_ON) :].mean():.3f}){told}"


def _fixed_text(
    each: Mapping[str, Mapping[str, Array]], best: Mapping[str, str], scales: Mapping[str, float], density: tuple[float, float]
) -> list[str]:  # fmt: skip
    met = [n for n, e in each.items() if e[OWN].mean() < e[best[n]].mean()]
    chosen = ", ".join(f"{name} {scale:g}" for name, scale in scales.items())
    return [
        "Both kinds get the same fixes and Doppler velocities with the same losses, and start off by 1 m. Those of four states are "
        "given the reference's heading; the INS finds its own.",
        f"Chosen on tracks 1-3 and training seeds by the one-step error of fixes, without the truth: `dvl_noise_scale` {chosen}; "
        f"dead reckoning {density[0]:g} and, through losses, {density[1]:g} m²/s. The log's errors go on for 10 to 30 s, which R cannot say: believed as white noise of "
        "its size it is believed too much, most of all by filters that measure R themselves.",
        f"Better in the mean than the best of four states at {len(met)} of {len(each)} rates.",
    ]
