"""Made-up logs: a vehicle that sails lazy eights, and one thing that is wrong with what its logger wrote."""

import dataclasses
from pathlib import Path

import numpy as np

import navgym
from navgym.deck.csv_log import write_deck_csv
from navgym.ins.csv_set import write_ins_csv
from navgym.ins.recording import Aiding

ROWS = 400
ROOT = Path(__file__).resolve().parents[2]


def eights(seed=0, rows=ROWS, step=1.0):
    """Columns of a sound log, as numbers: time, px, py, vx, vy, heading."""
    rng = np.random.default_rng(seed)
    t = step * np.arange(rows)
    fine = np.linspace(0.0, t[-1], 20 * rows)
    course = 2.0 * np.sin(2.0 * np.pi * fine / 90.0) + 0.01 * fine
    speed = 1.5 + 0.4 * np.sin(2.0 * np.pi * fine / 37.0)
    v = speed * np.stack([np.cos(course), np.sin(course)])
    dt = fine[1]
    p = np.cumsum(v, axis=1) * dt
    px, py = (np.interp(t, fine, axis) + rng.normal(0.0, 0.3, rows) for axis in p)
    vx, vy = (np.interp(t, fine, axis) + rng.normal(0.0, 0.05, rows) for axis in v)
    heading = np.degrees(np.interp(t, fine, course)) % 360.0
    return {"time": t, "px": px, "py": py, "vx": vx, "vy": vy, "heading": heading}


def written(path, columns):
    """A text file of columns; NaN is an empty cell."""
    digits = {"time": 3, "px": 2, "py": 2, "vx": 3, "vy": 3, "heading": 1}

    def cell(name, value):
        return "" if np.isnan(value) else f"{value:.{digits.get(name, 8)}f}"

    rows = zip(*([cell(n, v) for v in values] for n, values in columns.items()), strict=True)
    path.write_text("\n".join([",".join(columns), *map(",".join, rows)]) + "\n")
    return path


# ---- defects: each takes a folder and returns the log

DEFECTS = {}
CHANGES = {}  # what makes the columns of a sound log those of one with a defect


def defect(kind, channel=""):
    """Registers a log that has one defect of that kind."""

    def add(make):
        DEFECTS[make.__name__] = (kind, channel, make)
        return make

    return add


def _changed(name, change):
    """Writes a sound log with its columns changed."""

    def make(folder):
        columns = eights()
        columns = change(columns) or columns
        return written(folder / "log.csv", columns)

    make.__name__ = name
    return make


def _simple(kind, name, channel=""):
    def add(change):
        CHANGES[name] = change
        return defect(kind, channel)(_changed(name, change))

    return add


@_simple("gap", "rows are missing for a minute and a half")
def _(c):
    keep = np.r_[0:150, 240:ROWS]
    return {n: v[keep] for n, v in c.items()}


@_simple("clock step", "the clock jumps forward")
def _(c):
    c["time"][200:] += 60.0


@_simple("clock set", "the clock is set back")
def _(c):
    c["time"][200:] -= 50.25


@_simple("order", "rows come late")
def _(c):
    i = np.arange(ROWS)
    i[[100, 101]] = i[[101, 100]]
    return {n: v[i] for n, v in c.items()}


@_simple("duplicate", "rows stand there twice")
def _(c):
    i = np.sort(np.r_[0:ROWS, 50:60])
    return {n: v[i] for n, v in c.items()}


@_simple("conflict", "two rows of one time differ")
def _(c):
    c["time"][101] = c["time"][100]


@_simple("stamps", "stamps are whole tens of seconds")
def _(c):
    c["time"] = 10.0 * np.floor(c["time"] / 10.0)


@_simple("time unit", "times are ms and nobody says so")
def _(c):
    c["time"] = np.round(1e3 * c["time"])


@_simple("rate", "the rate halves")
def _(c):
    keep = np.r_[0:150, 150:ROWS:2]
    return {n: v[keep] for n, v in c.items()}


@_simple("held", "fixes are held between those of a slower receiver", "px")
def _(c):
    for n in ("px", "py"):
        c[n] = c[n][5 * (np.arange(ROWS) // 5)]


@_simple("frozen", "a velocity stands still for half a minute", "vx")
def _(c):
    c["vx"][200:230] = c["vx"][200]


@_simple("constant", "a velocity never changes", "vy")
def _(c):
    c["vy"][:] = 0.0


@_simple("empty", "a column holds nothing", "vy")
def _(c):
    c["vy"][:] = np.nan


@_simple("saturation", "a velocity log ends at 1.6 m/s", "vx")
def _(c):
    c["vx"] = np.clip(c["vx"], -1.6, 1.6)


@_simple("outliers", "three fixes are far off", "px")
def _(c):
    c["px"][[50, 170, 300]] += [700.0, -450.0, 900.0]


@_simple("jump", "positions are reset on the way", "px")
def _(c):
    c["px"][220:] += 300.0


@_simple("sentinel", "-9999 stands for no fix", "px")
def _(c):
    for n in ("px", "py"):
        c[n][[30, 31, 90, 200]] = -9999.0


@_simple("resolution", "positions are whole tens of metres", "px")
def _(c):
    slow = {n: c[n] / 20.0 for n in ("px", "py", "vx", "vy")}
    return (
        c
        | slow
        | {
            "px": 10.0
            * np.round(slow["px"] / 10.0 + 0.3 * np.random.default_rng(1).normal(size=ROWS))
        }
    )


@_simple("degrees", "degrees are called x and y")
def _(c):
    return {"time": c["time"], "y": 32.8 + c["px"] / 111e3, "x": 34.9 + c["py"] / 94e3}


@_simple("units", "velocities are in knots", "vx and vy")
def _(c):
    for n in ("vx", "vy"):
        c[n] /= 1852.0 / 3600.0


@_simple("units", "velocities are in cm per s", "vx and vy")
def _(c):
    for n in ("vx", "vy"):
        c[n] *= 100.0


@_simple("scale", "velocities are a third too large", "vx and vy")
def _(c):
    for n in ("vx", "vy"):
        c[n] *= 1.3


@_simple("sign", "west is called east", "vy")
def _(c):
    c["vy"] *= -1.0


@_simple("axes", "north and east are exchanged", "vx and vy")
def _(c):
    c["vx"], c["vy"] = c["vy"].copy(), c["vx"].copy()


@_simple("rotation", "velocities count from magnetic north", "vx and vy")
def _(c):
    z = (c["vx"] + 1j * c["vy"]) * np.exp(-0.21j)
    c["vx"], c["vy"] = z.real, z.imag


@_simple("frame", "velocities are forward and right", "vx and vy")
def _(c):
    z = (c["vx"] + 1j * c["vy"]) * np.exp(-1j * np.radians(c["heading"]))
    c["vx"], c["vy"] = z.real, z.imag


@_simple("heading", "heading counts from east", "heading")
def _(c):
    c["heading"] = (90.0 - c["heading"]) % 360.0


@_simple("heading", "heading is a quarter turn off", "heading")
def _(c):
    c["heading"] = (c["heading"] + 90.0) % 360.0


@_simple("heading", "heading is in radians", "heading")
def _(c):
    c["heading"] = np.radians(c["heading"])


@_simple("delay", "velocities are three seconds late", "velocity")
def _(c):
    for n in ("vx", "vy"):
        c[n] = np.interp(c["time"] - 3.0, c["time"], c[n])


@_simple("accuracy", "the receiver boasts", "px")
def _(c):
    return c | {"sigma_position": np.full(ROWS, 0.02)}


@_simple("infinite", "some fixes are infinite")
def _(c):
    c["px"][[10, 20]] = np.inf


@defect("text")
def a_word_stands_among_the_numbers(folder):
    path = written(folder / "log.csv", eights())
    text = path.read_text().splitlines()
    text[100] = text[100].replace(text[100].split(",")[1], "oops")
    path.write_text("\n".join(text))
    return path


@defect("cut")
def the_last_row_is_cut_off(folder):
    path = written(folder / "log.csv", eights())
    path.write_text(path.read_text().rstrip()[:-14])
    return path


@defect("columns")
def nothing_says_what_columns_hold(folder):
    c = eights()
    return written(folder / "log.csv", {"time": c["time"], "alpha": c["px"], "beta": c["py"]})


# ---- decks and INS


def _deck(folder, **changed):
    recording = dataclasses.replace(
        navgym.simulate("deck/paper", seed=1, duration=40.0), check_units=False, **changed
    )
    return recording.save(folder / "deck.npz")


def _deck_rates(**more):
    return navgym.simulate("deck/paper", seed=1, duration=40.0, **more)


@defect("gravity", "sub_acc")
def one_imu_of_a_deck_weighs_too_much(folder):
    return _deck(folder, sub_velocity=1.08 * _deck_rates().sub_velocity)


@defect("delay", "sub_gyro")
def one_imu_of_a_deck_is_late(folder):
    r = _deck_rates()
    late = 30
    shifted = {
        n: np.vstack([np.array(getattr(r, n))[:1].repeat(late, 0), np.array(getattr(r, n))[:-late]])
        for n in ("sub_angle", "sub_velocity")
    }
    return _deck(folder, **shifted)


@defect("unlike", "sub_gyro")
def one_imu_of_a_deck_has_another_scale(folder):
    return _deck(folder, sub_angle=1.4 * _deck_rates().sub_angle)


@defect("frozen", "sub_gyro_x")
def a_gyro_of_a_deck_hangs(folder):
    angle = np.array(_deck_rates().sub_angle)
    angle[2000:2050, 0] = angle[2000, 0]
    return _deck(folder, sub_angle=angle)


@defect("uneven")
def a_deck_log_misses_rows(folder):
    path = write_deck_csv(_deck_rates(), folder / "deck.csv")
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:2000] + lines[2100:]) + "\n")
    return path


def ins(seed=1, duration=45.0):
    """A sound INS recording."""
    return navgym.simulate("ins/nominal", seed=seed, duration=duration)


def _ins(folder, recording):
    write_ins_csv(dataclasses.replace(recording, check_units=False), folder / "set")
    return folder / "set"


def _with(recording, name, **fields):
    old = recording.aiding[name]
    new = Aiding(
        **{"time": old.time, "values": np.array(old.values), "lost": np.array(old.lost)} | fields
    )
    return dataclasses.replace(
        recording, aiding=dict(recording.aiding) | {name: new}, check_units=False
    )


@defect("axes")
def an_imu_is_mounted_the_other_way_up(folder):
    r = ins()
    turn = np.array([1.0, -1.0, -1.0])
    return _ins(
        folder,
        dataclasses.replace(r, angle=r.angle * turn, velocity=r.velocity * turn, check_units=False),
    )


@defect("outside", "dvl")
def a_doppler_log_has_another_clock(folder):
    r = ins()
    return _ins(folder, _with(r, "dvl", time=r.aiding["dvl"].time + 40.0))


@defect("units", "dvl")
def a_doppler_log_says_knots_for_metres(folder):
    r = ins(duration=120.0)  # what is half the speed may be noise for a while
    return _ins(folder, _with(r, "dvl", values=np.array(r.aiding["dvl"].values) * 0.5144))


@defect("saturation")
def a_gyro_stands_at_its_stop(folder):
    r = ins()
    angle = np.array(r.angle)
    stop = np.quantile(angle[:, 2], 0.97)
    angle[:, 2] = np.minimum(angle[:, 2], stop)
    return _ins(folder, dataclasses.replace(r, angle=angle, check_units=False))


__all__ = ["DEFECTS", "ROWS", "eights", "ins", "written"]
