"""ROS 1 bags, ROS 2 bags (sqlite3, MCAP) and single MCAP files, over rosbags.

Messages are read one by one, of the wanted types only. Frames are those of REP 103 and 105: the
world is east, north, up, the body forward, left, up, unless the name of a frame ends in ned or frd.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from navgym.formats.channels import ESTIMATE, SECOND, SENSOR, Gathered, Gatherer
from navgym.formats.frames import angles

NAN = math.nan
WORLDS = ("map", "odom", "world", "earth", "enu", "ned", "local_origin", "utm")
NED, FRD = ("ned",), ("frd", "ned", "fsd")  # how names of frames end whose axes are ours
TESLA = 1e6  # µT
EVERY = 2000  # messages between two reports of progress


@dataclass
class _Attitudes:
    """Quaternions of one topic, x, y, z, w, as they stand in its messages."""

    enu: bool
    flu: bool
    rank: int
    time: array[int] = field(default_factory=lambda: array("q"))
    quaternions: array[float] = field(default_factory=lambda: array("d"))


class _Bag:
    """What was taken from a bag so far."""

    def __init__(self, gatherer: Gatherer) -> None:
        self.gatherer = gatherer
        self.late = 0  # messages without a stamp
        self.attitudes: dict[str, _Attitudes] = {}

    def rows_of(self, topic: str, kind: str, rank: int = SENSOR) -> Gathered:
        """The rows of a topic."""
        return self.gatherer.rows_of(topic, kind, rank)

    def attitude(self, topic: str, stamp: int, world: str, body: str, q: Any, rank: int = SENSOR) -> None:  # fmt: skip
        """Keep an orientation of a body in a world, by the names of their frames."""
        if topic not in self.attitudes:
            self.attitudes[topic] = _Attitudes(not _ends(world, NED), not _ends(body, FRD), rank)
        told = self.attitudes[topic]
        told.quaternions.extend((q.x, q.y, q.z, q.w))
        told.time.append(stamp)

    def stamp(self, header: Any, received: int) -> int:
        """ns; of the sensor if it says so, else of the bag."""
        stamp = int(header.stamp.sec) * SECOND + int(header.stamp.nanosec)
        self.late += stamp <= 0
        return stamp if stamp > 0 else received

    def settle(self) -> None:
        """Hand the attitudes on, and say what was found."""
        for topic, told in self.attitudes.items():
            q = np.frombuffer(told.quaternions, np.float64).reshape(-1, 4)
            columns = dict(
                zip(("roll", "pitch", "heading"), angles(q, told.enu, told.flu).T, strict=True)
            )
            self.gatherer.add(
                topic, "attitude", np.frombuffer(told.time, np.int64), columns, told.rank
            )
        if self.late:
            self.gatherer.doubts.append(
                f"{self.late} messages have no stamp of their own: taken when they were received"
            )


Take = Callable[[_Bag, str, int, Any], None]


def read(path: Path, gatherer: Gatherer) -> None:
    """Every channel of a bag whose message type is known."""
    usual = get_typestore(Stores.LATEST)
    with AnyReader([path], default_typestore=usual) as bag:
        wanted = [c for c in bag.connections if _taker(c.msgtype) is not None]
        if not wanted:
            kinds = ", ".join(sorted({c.msgtype for c in bag.connections})) or "no message"
            raise ValueError(f"no topic of a type that is known, but {kinds}")
        total = max(sum(c.msgcount for c in wanted), 1)
        taken = _Bag(gatherer)
        for done, (connection, received, raw) in enumerate(bag.messages(wanted)):
            message: Any = bag.deserialize(raw, connection.msgtype)
            take = _taker(connection.msgtype)
            assert take is not None
            take(taken, connection.topic, taken.stamp(message.header, received), message)
            if done % EVERY == 0:
                gatherer.progress.at(min(done / total, 1.0))
    taken.settle()


def _taker(msgtype: str) -> Take | None:
    name = msgtype.rpartition("/")[2]
    return DVL if name in ("DVL", "Dvl") else TAKERS.get(msgtype)


# ---- frames


def _ends(frame: str, names: Sequence[str]) -> bool:
    return frame.lower().rstrip("/").endswith(tuple(names))


def _is_world(frame: str) -> bool:
    return _ends(frame, WORLDS)


def _to_ned(frame: str, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (x, y, z) if _ends(frame, NED) else (y, x, -z)


def _to_frd(frame: str, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (x, y, z) if _ends(frame, FRD) else (x, -y, -z)


def _sigma(variance: float) -> float:
    """0 and less stand for not known."""
    return math.sqrt(variance) if 0.0 < variance < math.inf else NAN


def _sigmas(covariance: Any, places: Sequence[int]) -> tuple[float, ...]:
    return tuple(_sigma(float(covariance[k])) for k in places)


# ---- messages


def _nav_sat_fix(g: _Bag, topic: str, stamp: int, m: Any) -> None:
    rows = g.rows_of(topic, "fix")
    if m.status.status < 0:  # no fix
        rows.add(stamp)
        return
    told = m.position_covariance_type > 0
    east, north, up = _sigmas(m.position_covariance, (0, 4, 8)) if told else (NAN,) * 3
    rows.add(stamp, m.latitude, m.longitude, m.altitude, north, east, up)


def _imu(g: _Bag, topic: str, stamp: int, m: Any) -> None:
    frame, w, a, q = m.header.frame_id, m.angular_velocity, m.linear_acceleration, m.orientation
    if m.angular_velocity_covariance[0] != -1.0 and m.linear_acceleration_covariance[0] != -1.0:
        rate, force = _to_frd(frame, w.x, w.y, w.z), _to_frd(frame, a.x, a.y, a.z)
        g.rows_of(topic, "imu").add(stamp, *rate, *force)
    if m.orientation_covariance[0] != -1.0:
        g.attitude(topic, stamp, frame, frame, q)


def _odometry(g: _Bag, topic: str, stamp: int, m: Any) -> None:
    world, body = m.header.frame_id, m.child_frame_id
    p, q, v = m.pose.pose.position, m.pose.pose.orientation, m.twist.twist.linear
    sigma = _sigmas(m.pose.covariance, (0, 7, 14))
    sigma = sigma if _ends(world, NED) else (sigma[1], sigma[0], sigma[2])
    g.rows_of(topic, "position", ESTIMATE).add(stamp, *_to_ned(world, p.x, p.y, p.z), *sigma)
    g.attitude(topic, stamp, world, body, q, ESTIMATE)
    spread = _sigmas(m.twist.covariance, (0, 7, 14))
    if body in ("", world) or _is_world(body):
        _velocity(g, topic, stamp, body or world, v, spread, ESTIMATE)
    else:
        _velocity(g, topic, stamp, body, v, spread, ESTIMATE, "body_velocity")


def _velocity(
    g: _Bag, topic: str, stamp: int, frame: str, v: Any, sigma: Sequence[float],
    rank: int = SENSOR, kind: str = "velocity",
) -> None:  # fmt: skip
    turned = (_to_ned if kind == "velocity" else _to_frd)(frame, v.x, v.y, v.z)
    if kind == "velocity" and not _ends(frame, NED):
        sigma = (sigma[1], sigma[0], sigma[2])
    g.rows_of(topic, kind, rank).add(stamp, *turned, *sigma)


def _twist(g: _Bag, topic: str, stamp: int, m: Any) -> None:
    frame, covaried = m.header.frame_id, hasattr(m.twist, "covariance")
    v = m.twist.twist.linear if covaried else m.twist.linear
    sigma = _sigmas(m.twist.covariance, (0, 7, 14)) if covaried else (NAN,) * 3
    kind = "velocity" if _is_world(frame) else "body_velocity"
    _velocity(g, topic, stamp, frame, v, sigma, kind=kind)


def _pose(g: _Bag, topic: str, stamp: int, m: Any) -> None:
    frame, covaried = m.header.frame_id, hasattr(m.pose, "covariance")
    p = m.pose.pose.position if covaried else m.pose.position
    sigma = _sigmas(m.pose.covariance, (0, 7, 14)) if covaried else (NAN,) * 3
    sigma = sigma if _ends(frame, NED) else (sigma[1], sigma[0], sigma[2])
    g.rows_of(topic, "position").add(stamp, *_to_ned(frame, p.x, p.y, p.z), *sigma)


def _dvl(g: _Bag, topic: str, stamp: int, m: Any) -> None:
    """Of any package: `velocity`, and what there is of validity and covariance."""
    covariance: Any = next((getattr(m, n) for n in ("covariance", "velocity_covar", "velocity_covariance") if hasattr(m, n)), ())  # fmt: skip
    good = bool(getattr(m, "velocity_valid", True))
    good = good and not (len(covariance) and covariance[0] < 0.0)  # -1: not valid
    rows = g.rows_of(topic, "body_velocity")
    if not good:
        rows.add(stamp)
        return
    v = m.velocity
    sigma = _sigmas(covariance, (0, 4, 8)) if len(covariance) == 9 else (NAN,) * 3
    # makers' own axes are forward, starboard, down; only frames that say so are turned
    frame = m.header.frame_id
    turned = (v.x, -v.y, -v.z) if _ends(frame, ("flu", "base_link")) else (v.x, v.y, v.z)
    rows.add(stamp, *turned, *sigma)


def _magnetic(g: _Bag, topic: str, stamp: int, m: Any) -> None:
    b = m.magnetic_field
    turned = _to_frd(m.header.frame_id, b.x, b.y, b.z)
    g.rows_of(topic, "magnetometer").add(stamp, *(TESLA * value for value in turned))


DVL: Take = _dvl
TAKERS: dict[str, Take] = {
    "sensor_msgs/msg/NavSatFix": _nav_sat_fix,
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/MagneticField": _magnetic,
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/TwistStamped": _twist,
    "geometry_msgs/msg/TwistWithCovarianceStamped": _twist,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose,
}
