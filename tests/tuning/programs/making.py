"""A world whose noises are known, logs of it, and a program in C that filters them."""

import subprocess
from pathlib import Path

import numpy as np

TRUE = {"walk_noise": 0.5, "meter_noise": 2.0}

CONTRACT = """
[parameters.walk_noise]
unit = "m/√s"
range = [0.01, 100.0]
default = 5.0
group = "process"

[parameters.meter_noise]
unit = "m"
range = [0.01, 100.0]
default = 0.5
group = "sensor"
"""


def series(seed, steps=400, walk_noise=0.5, meter_noise=2.0):
    """Times and measurements of a scalar that walks at random."""
    draw = np.random.default_rng(seed)
    walk = np.cumsum(walk_noise * draw.standard_normal(steps))
    return np.arange(steps, dtype=float), walk + meter_noise * draw.standard_normal(steps)


def write_log(path, seed, **more):
    time, z = series(seed, **more)
    path.write_text("time,z\n" + "".join(f"{t:g},{v:.12g}\n" for t, v in zip(time, z, strict=True)))
    return path


def logs(folder, count, **more):
    return [write_log(folder / f"log{i}.csv", i, **more) for i in range(count)]


def compiled(folder, source=None):
    """The program in C, compiled."""
    program = folder / "walk"
    source = source or Path(__file__).with_name("walk.c")
    subprocess.run(["cc", "-O2", "-o", str(program), str(source)], check=True)
    return program


def contract(folder, text=CONTRACT):
    path = folder / "walk.toml"
    path.write_text(text)
    return path


def kalman(series, parameters):
    """The same filter in Python, as a function."""
    time, z = series
    q, r = parameters["walk_noise"] ** 2, parameters["meter_noise"] ** 2
    x, P = 0.0, 100.0
    nu, s = np.empty(len(z)), np.empty(len(z))
    for k in range(len(z)):
        if k:
            P += q * (time[k] - time[k - 1])
        nu[k], s[k] = z[k] - x, P + r
        gain = P / s[k]
        x, P = x + gain * nu[k], (1.0 - gain) * P
    return {"time": time, "innovation": nu, "variance": s}
