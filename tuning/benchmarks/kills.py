"""A study of a program that is killed again and again: `python -m navgym.tuning.benchmarks.kills`."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from navgym.tuning.benchmarks.programs import simulated

FILTER = """BEGIN { FS = ","; q = 1; r = 1; P = 100; x = 0; print "time,innovation,variance" > out }
FILENAME != log_ { split($0, w, " = "); if (w[1] == "walk") q = w[2]^2; if (w[1] == "meter") r = w[2]^2; next }
FNR > 1 { if (seen) P += q * ($1 - t); S = P + r; nu = $2 - x; K = P / S; x += K * nu; P *= 1 - K; t = $1; seen = 1
  printf "%.9g,%.12g,%.12g\\n", t, nu, S > out }
"""


def kills(count: int = 20, workers: int = 1) -> dict[str, Any]:
    """A study of a program that leaves children, killed again and again at random moments."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "walk.awk").write_text(FILTER)
        (folder / "walk.toml").write_text(
            "".join(
                f"[parameters.{n}]\nrange = [0.01, 100.0]\ndefault = 5.0\n"
                for n in ("walk", "meter")
            )
        )
        for i in range(6):
            t, z = simulated(i, 200)
            (folder / f"log{i}.csv").write_text(
                "time,z\n" + "".join(f"{a:g},{b:.9g}\n" for a, b in zip(t, z, strict=True))
            )
        mark = f"98{os.getpid()}"
        program = f"sh -c 'sleep {mark} & setsid sleep {mark} & exec awk -v out=$2 -v log_=$1 -f $3 $0 $1' {{parameters}} {{log}} {{out}} walk.awk"
        words = [
            sys.executable, "-m", "navgym.command", "tune", "--program", program, "--parameters", "walk.toml", "--log",
            *(f"log{i}.csv" for i in range(4)), "--trials", "16", "--workers", str(workers), "--out",
        ]  # fmt: skip
        draw, lost, left, killed = np.random.default_rng(1), 0, 0, 0
        before: set[str] = set()
        while killed < count:
            process = subprocess.Popen(
                [*words, "out"],
                cwd=folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            grown, until = _kept(folder), time.monotonic() + 60.0
            while time.monotonic() < until and _kept(folder) == grown and process.poll() is None:
                time.sleep(0.02)
            time.sleep(float(draw.uniform(0.0, 0.6)))
            if (
                process.poll() is not None
            ):  # it came to its end: the rest of the kills is of a new one
                for path in ("out/study.log", "out/results.json"):
                    (folder / path).unlink(missing_ok=True)
                subprocess.run(["rm", "-rf", str(folder / "out")], check=True)
                before = set()
                continue
            now = _kept(folder)
            process.send_signal(signal.SIGKILL)
            process.wait()
            killed += 1
            lost += len(before - _kept(folder)) + len(now - _kept(folder))
            before = _kept(folder)
            left += _left(mark, folder)
        ends = []
        for out in ("out", "whole"):
            subprocess.run(
                [*words, out],
                cwd=folder,
                check=True,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            found = json.loads((folder / out / "results.json").read_text())
            ends.append([(t["values"], t["result"]) for t in found["trials"]])
        return {
            "kills": killed,
            "finished runs lost": lost,
            "processes left after 3 s": left,
            "same trials as a study that was not killed": ends[0] == ends[1],
        }


def _kept(folder: Path) -> set[str]:
    return {str(p) for p in (folder / "out" / "runs").rglob("*.json")}


def _left(mark: str, folder: Path) -> int:
    """Processes of the study or the program that are there after three seconds."""
    until, found = time.monotonic() + 3.0, 1
    while found and time.monotonic() < until:
        found = 0
        for place in Path("/proc").glob("[0-9]*"):
            try:
                words = (place / "cmdline").read_bytes().decode("utf-8", "replace")
                state = (place / "stat").read_text().rsplit(")", 1)[1].split()[0]
            except OSError:
                continue
            own = mark in words or str(folder) in words
            found += own and state != "Z" and int(place.name) != os.getpid()
        time.sleep(0.05)
    return found


if __name__ == "__main__":
    print(json.dumps(kills(*map(int, sys.argv[1:])), indent=1))
