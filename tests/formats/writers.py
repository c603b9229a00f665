"""Small logs of every kind, written by the kinds' own libraries from one voyage."""

import datetime as dt
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

START = 1_795_910_370 * 10**9  # ns since 1970: half a minute before a midnight
ORIGIN = (59.3, 18.1)
GRAVITY = 9.80665
METRES = (111_413.0, 56_987.0)  # of a degree of latitude and longitude there


@dataclass(frozen=True)
class Voyage:
    """A slow turn, sampled every `step` s: forward at 2 m/s, the heading growing by 0.02 rad/s."""

    count: int = 60
    step: float = 1.0

    @property
    def seconds(self):
        return self.step * np.arange(self.count)

    @property
    def stamps(self):
        return START + np.round(self.seconds * 1e9).astype(np.int64)

    @property
    def heading(self):
        return 0.7 + 0.02 * self.seconds

    @property
    def velocity(self):
        """North, east, down, m/s."""
        return 2.0 * np.column_stack([np.cos(self.heading), np.sin(self.heading), 0.0 * self.seconds])

    @property
    def position(self):
        """North, east, down, m."""
        h = self.heading
        return 100.0 * np.column_stack([np.sin(h) - np.sin(0.7), np.cos(0.7) - np.cos(h), 0.0 * h])

    @property
    def places(self):
        """Latitude, longitude, °."""
        return np.array(ORIGIN) + self.position[:, :2] / METRES

    @property
    def to_enu(self):
        """Quaternions x, y, z, w from forward, left, up to east, north, up."""
        return Rotation.from_euler("z", (np.pi / 2 - self.heading)[:, None]).as_quat()


# ---- NMEA 0183


def nmea(path, voyage=Voyage(), course="RMC", heading=True):
    from pynmeagps import GET, NMEAMessage

    out = []
    for k, stamp in enumerate(voyage.stamps.tolist()):
        now = dt.datetime.fromtimestamp(stamp / 1e9, dt.UTC)
        (lat, lon), time = voyage.places[k], now.time()
        place = {"lat": lat, "NS": "N", "lon": lon, "EW": "E", "hpnmeamode": 1}
        moving = {"spd": 2.0 / 1852 * 3600, "cog": np.degrees(voyage.heading[k]) % 360}
        out.append(NMEAMessage("GN", "GGA", GET, time=time, quality=4, alt=10.0, sep=23.0, **place))
        out.append(NMEAMessage("GN", "GST", GET, time=time, stdLat=0.8, stdLong=0.7, stdAlt=1.5))
        if course == "RMC":
            out.append(NMEAMessage("GN", "RMC", GET, time=time, status="A", date=now.date(), **place, **moving))
        else:
            out.append(NMEAMessage("GN", "VTG", GET, cogt=moving["cog"], sogn=moving["spd"]))
        if heading:
            out.append(NMEAMessage("GN", "HDT", GET, headingT=moving["cog"]))
    path.write_bytes(b"".join(message.serialize() for message in out))
    return path


# ---- ROS


def header(store, stamp, frame, ros1=False):
    Time, Header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    stamp = Time(sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
    return Header(seq=0, stamp=stamp, frame_id=frame) if ros1 else Header(stamp=stamp, frame_id=frame)


DVL_MSG = """std_msgs/Header header
geometry_msgs/Vector3 velocity
float64[9] covariance
bool velocity_valid
float64 altitude
"""


def _vector(store, values):
    return store.types["geometry_msgs/msg/Vector3"](*map(float, values))


def messages(store, voyage, ros1=False, without=()):
    """(topic, type, stamp, message) of every type that is read."""
    T = store.types
    Quaternion, Point = T["geometry_msgs/msg/Quaternion"], T["geometry_msgs/msg/Point"]
    none, fine = np.zeros(9), np.diag([0.25, 0.16, 1.0]).ravel()
    for k, stamp in enumerate(voyage.stamps.tolist()):
        q = Quaternion(*voyage.to_enu[k].tolist())
        n, e, d = voyage.position[k].tolist()

        def head(frame, stamp=stamp):
            return header(store, stamp, frame, ros1)

        status = T["sensor_msgs/msg/NavSatStatus"](status=0 if k != 3 else -1, service=1)
        yield "/gps/fix", "sensor_msgs/msg/NavSatFix", stamp, T["sensor_msgs/msg/NavSatFix"](
            head("gps"), status, *voyage.places[k].tolist(), 33.0, fine, 2)
        yield "/imu", "sensor_msgs/msg/Imu", stamp, T["sensor_msgs/msg/Imu"](
            head("imu_link"), q, none, _vector(store, (0.0, 0.0, -0.02)), none,
            _vector(store, (0.1, 0.2, GRAVITY)), none)
        twist = T["geometry_msgs/msg/Twist"](_vector(store, (2.0, 0.0, 0.0)), _vector(store, (0, 0, -0.02)))
        cov = np.diag([0.01, 0.04, 0.09, 1, 1, 1.0]).ravel()
        twist = T["geometry_msgs/msg/TwistWithCovariance"](twist, cov)
        yield "/log/twist", "geometry_msgs/msg/TwistWithCovarianceStamped", stamp, T[
            "geometry_msgs/msg/TwistWithCovarianceStamped"](head("base_link"), twist)
        pose = T["geometry_msgs/msg/Pose"](Point(e, n, -d), q)
        pose = T["geometry_msgs/msg/PoseWithCovariance"](pose, cov)
        yield "/odom", "nav_msgs/msg/Odometry", stamp, T["nav_msgs/msg/Odometry"](
            head("odom"), "base_link", pose, twist)
        valid = k % 5 != 4
        yield "/dvl", "dvl_msgs/msg/DVL", stamp, T["dvl_msgs/msg/DVL"](
            head("dvl"), _vector(store, (2.0, 0.0, 0.0)), np.diag([1e-4] * 3).ravel(), valid, 5.0)


def typestore(ros1=False):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(DVL_MSG, "dvl_msgs/msg/DVL"))
    return store


def bag(path, voyage=Voyage(), kind="mcap", without=(), more=()):
    """A bag: "mcap", "sqlite3" (folders) or "ros1" (a file); `more` are further messages."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer

    ros1 = kind == "ros1"
    store = typestore(ros1)
    writer = Writer1(path) if ros1 else Writer(
        path, version=8, storage_plugin=StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3)
    known = {}
    with writer:
        for topic, name, stamp, message in [*messages(store, voyage, ros1), *more]:
            if topic in without:
                continue
            if topic not in known:
                known[topic] = writer.add_connection(topic, name, typestore=store)
            raw = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, name)
            writer.write(known[topic], stamp + 5_000_000, raw)
    return path
