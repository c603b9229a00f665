"""Write navgym/sample_log.csv: a simulated voyage, with what loggers do to logs.

python scripts/make_sample_log.py
"""

from __future__ import annotations

import argparse
import datetime as dt
from pathlib import Path

import numpy as np

from navgym.auv.geodesy import from_plane

TARGET = Path(__file__).resolve().parents[1] / "navgym" / "sample_log.csv"
ORIGIN = (59.3, 18.1, 0.0)
START = dt.datetime(2026, 5, 4, 6, 30, tzinfo=dt.UTC)
ROWS, EVERY = 3000, 5  # of the logger, five a second; of which a receiver's fix is new
KNOT = 1852.0 / 3600.0
HEAD = """\
# simulated by navgym (scripts/make_sample_log.py): a small vehicle off Stockholm, ten minutes
# logger 5 Hz; GNSS 1 Hz, held between fixes, none while under the bridge; Doppler log in knots, "---" without bottom
Time (UTC);Latitude;Longitude;hAcc (m);Vel N (kn);Vel E (kn);Battery (V)
"""


def main() -> None:
    """Simulate, spoil and write."""
    rng = np.random.default_rng(2026)
    t = 0.2 * np.arange(ROWS)
    course = 0.9 * np.sin(t / 55.0) + 0.6 * np.sin(t / 17.0) + t / 300.0
    speed = 1.6 + 0.3 * np.sin(t / 41.0)
    v = np.stack([speed * np.cos(course), speed * np.sin(course)])
    p = np.cumsum(v, axis=1) * 0.2
    accuracy = np.where((t > 200) & (t < 320), 2.5, 0.8)
    fixes = p + rng.normal(0.0, 1.0, p.shape) * accuracy
    latitude, longitude = from_plane(*fixes, ORIGIN)
    velocity = (v + rng.normal(0.0, 0.06, v.shape)) / KNOT
    bottom = rng.random(ROWS // 25).repeat(25) > 0.08
    rows = []
    for k in range(ROWS):
        fix = k // EVERY * EVERY
        bridge = 420.0 < t[fix] < 445.0
        place = ";;" if bridge else f"{latitude[fix]:.7f};{longitude[fix]:.7f};{accuracy[fix]:.1f}"
        moved = f"{velocity[0, k]:.2f};{velocity[1, k]:.2f}" if bottom[k] else "---;---"
        when = (
            (START + dt.timedelta(seconds=float(t[k])))
            .isoformat(timespec="milliseconds")
            .replace("+00:00", "Z")
        )
        rows.append(f"{when};{place};{moved};{12.6 - t[k] / 4000:.2f}")
    rows = [f"{r.partition(';')[0]};{r.partition(';')[2].replace('.', ',')}" for r in rows]
    for k in (700, 701, 1900):  # came late
        rows[k], rows[k + 1] = rows[k + 1], rows[k]
    TARGET.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    main()
