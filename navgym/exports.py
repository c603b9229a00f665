"""An estimate as other programs read it: poses for evo and PlotJuggler, tracks for maps."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from navgym.core.atomic import replacing

if TYPE_CHECKING:
    from navgym.estimation import Estimate

FINE = 8  # digits after the point of degrees: a millimetre


def to_tum(estimate: Estimate, path: Path) -> Path:
    """See `Estimate.to_tum`."""
    position, attitude = estimate.pose
    rows = np.column_stack([estimate.time, position, attitude])
    with replacing(path, text=True) as file:
        for row in rows[np.isfinite(rows).all(axis=1)].tolist():
            file.write(" ".join([repr(row[0]), *(f"{x:.9g}" for x in row[1:])]) + "\n")
    return path


def to_geojson(estimate: Estimate, path: Path) -> Path:
    """See `Estimate.to_geojson`."""
    places = estimate.places
    good = np.isfinite(places).all(axis=1)
    line = [
        [round(lon, FINE), round(lat, FINE), round(up, 3)] for lat, lon, up in places[good].tolist()
    ]
    start = _start(estimate)
    properties: dict[str, Any] = {"time": estimate.time[good].tolist(), "health": estimate.health}
    if start is not None:
        properties["start"] = start.isoformat()
    feature = {
        "type": "Feature", "properties": properties,
        "geometry": {"type": "LineString", "coordinates": line},
    }  # fmt: skip
    with replacing(path, text=True) as file:
        json.dump({"type": "FeatureCollection", "features": [feature]}, file, allow_nan=False)
    return path


def to_gpx(estimate: Estimate, path: Path) -> Path:
    """See `Estimate.to_gpx`."""
    places, start = estimate.places, _start(estimate)
    with replacing(path, text=True) as file:
        file.write('<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator="navgym" '
                   'xmlns="http://www.topografix.com/GPX/1/1">\n<trk><trkseg>\n')  # fmt: skip
        for time, place in zip(estimate.time.tolist(), places.tolist(), strict=True):
            if np.isfinite(place).all():
                file.write(_point(time, place, start))
        file.write("</trkseg></trk>\n</gpx>\n")
    return path


def _point(time: float, place: list[float], start: dt.datetime | None) -> str:
    when = ""
    if start is not None:
        stamp = (start + dt.timedelta(seconds=time)).isoformat(timespec="milliseconds")
        when = f"<time>{stamp.replace('+00:00', 'Z')}</time>"
    latitude, longitude, height = place
    return f'<trkpt lat="{latitude:.{FINE}f}" lon="{longitude:.{FINE}f}"><ele>{height:.3f}</ele>{when}</trkpt>\n'


def _start(estimate: Estimate) -> dt.datetime | None:
    """The date from which times count, where the log has one."""
    text = getattr(estimate.recording, "meta", {}).get("start")
    try:
        found = dt.datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return found if found.tzinfo else found.replace(tzinfo=dt.UTC)
