"""Small logs of every kind, written by the kinds' own libraries from one voyage."""

import datetime as dt
from dataclasses import dataclass
from functools import cached_property, partial

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
    start: int = START  # ns since 1970
    speed_noise: float = 0.01  # m/s, that a Doppler log tells of itself

    @cached_property
    def seconds(self):
        return self.step * np.arange(self.count)

    @cached_property
    def stamps(self):
        return self.start + np.round(self.seconds * 1e9).astype(np.int64)

    @cached_property
    def heading(self):
        return (0.7 + 0.02 * self.seconds + np.pi) % (2 * np.pi) - np.pi

    @cached_property
    def velocity(self):
        """North, east, down, m/s."""
        return 2.0 * np.column_stack(
            [np.cos(self.heading), np.sin(self.heading), 0.0 * self.seconds]
        )

    @cached_property
    def position(self):
        """North, east, down, m."""
        h = self.heading
        return 100.0 * np.column_stack([np.sin(h) - np.sin(0.7), np.cos(0.7) - np.cos(h), 0.0 * h])

    @cached_property
    def speed(self):
        """Over ground, m/s."""
        return np.hypot(*self.velocity[:, :2].T)

    @cached_property
    def course(self):
        """Over ground, degrees from 0 to 360."""
        return np.degrees(np.arctan2(self.velocity[:, 1], self.velocity[:, 0])) % 360

    @cached_property
    def body(self):
        """Velocity forward, starboard, down, m/s."""
        v = (self.velocity[:, 0] + 1j * self.velocity[:, 1]) * np.exp(-1j * self.heading)
        return np.column_stack([v.real, v.imag, 0.0 * v.real])

    @cached_property
    def places(self):
        """Latitude, longitude, °."""
        return np.array(ORIGIN) + self.position[:, :2] / METRES

    @cached_property
    def to_enu(self):
        """Quaternions x, y, z, w from forward, left, up to east, north, up."""
        return Rotation.from_euler("z", (np.pi / 2 - self.heading)[:, None]).as_quat()


class Sailed(Voyage):
    """A voyage as columns tell it: time, px, py, vx, vy, heading in degrees, a row per sample."""

    def __init__(self, columns, start=START + 600 * 10**9):
        super().__init__(len(columns["time"]), 1.0, start, 0.05)
        zero = np.zeros(self.count)
        told = {
            "seconds": columns["time"],
            "heading": (np.radians(columns["heading"]) + np.pi) % (2 * np.pi) - np.pi,
            "velocity": np.column_stack([columns["vx"], columns["vy"], zero]),
            "position": np.column_stack([columns["px"], columns["py"], zero]),
        }
        self.__dict__.update(told)  # in place of cached properties


# ---- NMEA 0183


def nmea(path, voyage=Voyage(), course="RMC", heading=True):
    from pynmeagps import GET, NMEAMessage

    out = []
    for k, stamp in enumerate(voyage.stamps.tolist()):
        now = dt.datetime.fromtimestamp(stamp / 1e9, dt.UTC)
        (lat, lon), time = voyage.places[k], now.time()
        place = {"lat": lat, "NS": "N", "lon": lon, "EW": "E", "hpnmeamode": 1}
        moving = {"spd": voyage.speed[k] / 1852 * 3600, "cog": voyage.course[k]}
        out.append(NMEAMessage("GN", "GGA", GET, time=time, quality=4, alt=10.0, sep=23.0, **place))
        out.append(NMEAMessage("GN", "GST", GET, time=time, stdLat=0.8, stdLong=0.7, stdAlt=1.5))
        if course == "RMC":
            out.append(
                NMEAMessage(
                    "GN", "RMC", GET, time=time, status="A", date=now.date(), **place, **moving
                )
            )
        else:
            out.append(NMEAMessage("GN", "VTG", GET, cogt=moving["cog"], sogn=moving["spd"]))
        if heading:
            out.append(NMEAMessage("GN", "HDT", GET, headingT=np.degrees(voyage.heading[k]) % 360))
    path.write_bytes(b"".join(message.serialize() for message in out))
    return path


# ---- ROS


def header(store, stamp, frame, ros1=False):
    Time, Header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    stamp = Time(sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
    return (
        Header(seq=0, stamp=stamp, frame_id=frame) if ros1 else Header(stamp=stamp, frame_id=frame)
    )


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
        yield (
            "/gps/fix",
            "sensor_msgs/msg/NavSatFix",
            stamp,
            T["sensor_msgs/msg/NavSatFix"](
                head("gps"), status, *voyage.places[k].tolist(), 33.0, fine, 2
            ),
        )
        yield (
            "/imu",
            "sensor_msgs/msg/Imu",
            stamp,
            T["sensor_msgs/msg/Imu"](
                head("imu_link"),
                q,
                none,
                _vector(store, (0.0, 0.0, -0.02)),
                none,
                _vector(store, (0.1, 0.2, GRAVITY)),
                none,
            ),
        )
        forward, starboard, down = voyage.body[k].tolist()
        twist = T["geometry_msgs/msg/Twist"](
            _vector(store, (forward, -starboard, -down)), _vector(store, (0, 0, -0.02))
        )
        cov = np.diag([0.01, 0.04, 0.09, 1, 1, 1.0]).ravel()
        twist = T["geometry_msgs/msg/TwistWithCovariance"](twist, cov)
        yield (
            "/log/twist",
            "geometry_msgs/msg/TwistWithCovarianceStamped",
            stamp,
            T["geometry_msgs/msg/TwistWithCovarianceStamped"](head("base_link"), twist),
        )
        pose = T["geometry_msgs/msg/Pose"](Point(e, n, -d), q)
        pose = T["geometry_msgs/msg/PoseWithCovariance"](pose, cov)
        yield (
            "/odom",
            "nav_msgs/msg/Odometry",
            stamp,
            T["nav_msgs/msg/Odometry"](head("odom"), "base_link", pose, twist),
        )
        valid = k % 5 != 4
        yield (
            "/dvl",
            "dvl_msgs/msg/DVL",
            stamp,
            T["dvl_msgs/msg/DVL"](
                head("dvl"),
                _vector(store, (forward, starboard, down)),
                np.diag([voyage.speed_noise**2] * 3).ravel(),
                valid,
                5.0,
            ),
        )


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
    writer = (
        Writer1(path)
        if ros1
        else Writer(
            path,
            version=8,
            storage_plugin=StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3,
        )
    )
    known, count, sailed = {}, {}, isinstance(voyage, Sailed)
    with writer:
        for topic, name, stamp, message in [*messages(store, voyage, ros1), *more]:
            if topic in without:
                continue
            if topic not in known:
                known[topic] = writer.add_connection(topic, name, typestore=store)
            raw = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, name)
            at = count[topic] = count.get(topic, -1) + 1  # the recorder's own clock is never set
            received = voyage.start + round(at * voyage.step * 1e9) if sailed else stamp
            writer.write(known[topic], received + 5_000_000, raw)
    return path


def mcap_crc(path, voyage=Voyage()):
    """Velocities, by the writer of the makers of MCAP, which guards chunks by checksums."""
    from mcap_ros2.writer import Writer

    bar = "=" * 80
    text = (
        "std_msgs/Header header\ngeometry_msgs/Twist twist\n"
        f"{bar}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        f"{bar}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        f"{bar}\nMSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
        f"{bar}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
    )
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("geometry_msgs/msg/TwistStamped", text)
        for k, stamp in enumerate(voyage.stamps.tolist()):
            n, e, _ = voyage.velocity[k].tolist()
            head = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "map"}
            twist = {
                "linear": {"x": e, "y": n, "z": 0.0},
                "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
            }
            message = {"header": head, "twist": twist}
            writer.write_message("/speed", schema, message, log_time=stamp, publish_time=stamp)
        writer.finish()
    return path


# ---- PX4


ULOG_TYPES = {"uint64_t": "Q", "float": "f", "double": "d", "uint8_t": "B", "bool": "?"}
ULOG_MESSAGES = {
    "vehicle_gps_position": ["uint64_t timestamp", "double latitude_deg", "double longitude_deg",
        "double altitude_msl_m", "double altitude_ellipsoid_m", "float eph", "float epv",
        "float s_variance_m_s", "float vel_n_m_s", "float vel_e_m_s", "float vel_d_m_s",
        "uint8_t fix_type", "bool vel_ned_valid"],
    "sensor_combined": ["uint64_t timestamp", "float[3] gyro_rad", "float[3] accelerometer_m_s2"],
    "vehicle_attitude": ["uint64_t timestamp", "uint64_t timestamp_sample", "float[4] q"],
    "vehicle_local_position": ["uint64_t timestamp", "float x", "float y", "float z", "float vx",
        "float vy", "float vz"],
}  # fmt: skip


def ulog(path, voyage=Voyage()):
    """First by hand, as pyulog writes only what it has read; then by pyulog."""
    import io
    import struct

    from pyulog import ULog

    def record(kind, data):
        return struct.pack("<HB", len(data), ord(kind)) + data

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), record("B", bytes(40))]
    for name, fields in ULOG_MESSAGES.items():
        out.append(record("F", f"{name}:{';'.join(fields)};".encode()))
    for k, name in enumerate(ULOG_MESSAGES):
        out.append(record("A", struct.pack("<BH", 0, k) + name.encode()))
    for k, stamp in enumerate((voyage.stamps - START + 10**9) // 1000):
        half = voyage.heading[k] / 2
        rows = (
            (stamp, *voyage.places[k], 10.0, 33.0, 0.8, 1.5, 0.2, *voyage.velocity[k], 3, True),
            (stamp, 0.0, 0.0, 0.02, 0.1, -0.2, -GRAVITY),
            (stamp, stamp, np.cos(half), 0.0, 0.0, np.sin(half)),
            (stamp, *voyage.position[k], *voyage.velocity[k]),
        )
        for j, (row, fields) in enumerate(zip(rows, ULOG_MESSAGES.values(), strict=True)):
            letters = ""
            for each in fields:
                kind, _, times = each.split()[0].partition("[")
                letters += ULOG_TYPES[kind] * int(times.rstrip("]") or 1)
            out.append(record("D", struct.pack("<H", j) + struct.pack(f"<{letters}", *row)))
    log = ULog(io.BytesIO(b"".join(out)))
    log.write_ulog(str(path))
    return path


# ---- ArduPilot


def dataflash(path, voyage=Voyage()):
    from types import SimpleNamespace

    from pymavlink.DFReader import DFFormat, DFReader_binary

    head = DFFormat(0x80, "FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns")
    maker = SimpleNamespace(formats={0x80: head})
    formats = {
        "GPS": ("QBBIHLLefff", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs,VZ"),
        "GPA": ("QBCCC", "TimeUS,I,VAcc,HAcc,SAcc"),
        "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "ATT": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
        "XKF1": ("QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    }
    out, known = [DFReader_binary.make_format_msgbuf(maker, head)], {}
    for k, (name, (letters, columns)) in enumerate(formats.items()):
        known[name] = DFFormat(0x90 + k, name, 0, letters, columns)
        out.append(DFReader_binary.make_format_msgbuf(maker, known[name]))
    for k, stamp in enumerate((voyage.stamps - START + 10**9) // 1000):
        (lat, lon), v = voyage.places[k], voyage.velocity[k]
        degrees = float(np.degrees(voyage.heading[k]))
        speed, course = float(voyage.speed[k]), float(voyage.course[k])
        for name, row in (
            (
                "GPS",
                (
                    0,
                    3,
                    1000 * k,
                    2440,
                    round(lat * 1e7),
                    round(lon * 1e7),
                    3300,
                    speed,
                    course,
                    0.0,
                ),
            ),
            ("GPA", (0, 150, 80, 20)),
            ("IMU", (0, 0.0, 0.0, 0.02, 0.1, -0.2, -GRAVITY)),
            ("IMU", (1, 0.0, 0.0, 0.02, 0.1, -0.2, -GRAVITY)),
            ("ATT", (0.0, 0.0, degrees)),
            ("XKF1", (0, *v, *voyage.position[k])),
        ):
            out.append(DFReader_binary.make_msgbuf(maker, known[name], [int(stamp), *row]))
    path.write_bytes(b"".join(out))
    return path


def tlog(path, voyage=Voyage()):
    import struct

    from pymavlink.dialects.v20 import ardupilotmega as mav

    link = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as file:
        for k, stamp in enumerate(voyage.stamps // 1000):
            lat, lon = (round(value * 1e7) for value in voyage.places[k])
            v, ms = voyage.velocity[k], int(voyage.seconds[k] * 1000)
            course, speed = round(voyage.course[k] * 100) % 36000, round(voyage.speed[k] * 100)
            for message in (
                mav.MAVLink_gps_raw_int_message(
                    (ms + 1) * 1000,
                    3,
                    lat,
                    lon,
                    10000,
                    80,
                    150,
                    speed,
                    course,
                    9,
                    33000,
                    800,
                    1500,
                    200,
                    0,
                ),
                mav.MAVLink_attitude_message(ms + 1, 0.0, 0.0, voyage.heading[k], 0.0, 0.0, 0.02),
                mav.MAVLink_scaled_imu_message(ms + 1, 10, -20, -1000, 0, 0, 20, 0, 0, 0),
                mav.MAVLink_local_position_ned_message(ms + 1, *voyage.position[k], *v),
            ):
                file.write(struct.pack(">Q", int(stamp)) + message.pack(link))
                link.seq = (link.seq + 1) % 256
    return path


# ---- SBET and PD0, for which there is no writer but this


def sbet(path, voyage=Voyage(), hand=(-1.0, -1.0, -1.0), wander=0.3):
    a, b, d = hand
    c, s = np.cos(wander), np.sin(wander)
    turned = np.array([[c, a * s], [b * s, d * c]])
    x, y = np.linalg.solve(turned, voyage.velocity[:, :2].T)
    lat, lon = np.radians(voyage.places.T)
    zero = np.zeros(voyage.count)
    time = 200_000.0 + voyage.seconds
    rows = [
        time,
        lat,
        lon,
        zero + 33.0,
        x,
        y,
        zero,
        zero,
        zero,
        voyage.heading + wander,
        zero + wander,
    ]
    np.column_stack([*rows, *[zero] * 6]).astype("<f8").tofile(path)
    return path


@dataclass(frozen=True)
class Mount:
    """How a Doppler log sits in its vessel: degrees."""

    pitch: float = 0.0  # y, towards beam 3, up
    roll: float = 0.0  # x, towards beam 2 of one that looks down, down
    alignment: float = 0.0  # of beam 3 clockwise from the bow
    up: bool = False
    convex: bool = True
    angle: int = 20
    told: int = 20  # angle in the leader's last byte, 0 for none
    silent: tuple = ()  # beams that hear nothing

    @property
    def axes(self):
        """x, y, z of the instrument as columns: starboard, forward, up of the vessel."""
        turns = [("z", -self.alignment), ("x", self.pitch), ("y", self.roll + 180.0 * self.up)]
        whole = Rotation.identity()
        for axis, degrees in turns:
            whole = whole * Rotation.from_euler(axis, degrees, degrees=True)
        return whole.as_matrix()

    @property
    def beams(self):
        """Unit vectors along the beams, away from the instrument, as rows: in its own axes."""
        s, c = np.sin(np.radians(self.angle)), np.cos(np.radians(self.angle))
        s = s if self.convex else -s
        return np.array([[-s, 0, -c], [s, 0, -c], [0, s, -c], [0, -s, -c]])


def pd0(path, voyage=Voyage(), axes=3, mount=Mount()):
    import struct

    out = []
    for k, stamp in enumerate(voyage.stamps.tolist()):
        now = dt.datetime.fromtimestamp(stamp / 1e9, dt.UTC)
        fixed = bytearray(59)
        fixed[4] = mount.convex << 3 | mount.up << 7
        fixed[5] = {15: 0, 20: 1, 30: 2}.get(mount.angle, 3)
        fixed[8] = 4
        fixed[25] = axes << 3 | 7
        fixed[26:28] = struct.pack("<h", round(100 * mount.alignment))
        fixed[58] = mount.told
        variable = bytearray(65)
        variable[:2] = struct.pack("<H", 0x80)
        clock = [now.month, now.day, now.hour, now.minute, now.second, stamp // 10**7 % 100]
        variable[4:11] = bytes([now.year - 2000, *clock])
        variable[18:20] = struct.pack("<H", round(np.degrees(voyage.heading[k]) * 100) % 36000)
        variable[20:24] = struct.pack("<2h", round(100 * mount.pitch), round(100 * mount.roll))
        variable[57:65] = bytes([20, *variable[4:11]])
        n, e, _ = voyage.velocity[k]
        bottom = bytearray(81)
        bottom[:2] = struct.pack("<H", 0x600)
        forward, starboard, down = voyage.body[k]
        instrument = mount.axes.T @ [starboard, forward, -down]
        # the vessel moves along a beam as fast as the bottom comes along it
        told = {
            3: (-e, -n, 0.0, 0.003), 2: (-starboard, -forward, down, 0.003),
            1: (*-instrument, 0.003), 0: mount.beams @ instrument,
        }[axes]  # fmt: skip
        four = [round(1000 * value) for value in told]
        if k % 7 == 6:
            four = [-32768] * 4
        four = [-32768 if j in mount.silent else value for j, value in enumerate(four)]
        bottom[24:32] = struct.pack("<4h", *four)
        blocks = [bytes(fixed), bytes(variable), bytes(bottom)]
        offsets = [12 + sum(map(len, blocks[:j])) for j in range(3)]
        size = 12 + sum(map(len, blocks))
        whole = b"\x7f\x7f" + struct.pack("<HBB3H", size, 0, 3, *offsets) + b"".join(blocks)
        out.append(whole + struct.pack("<H", sum(whole) & 0xFFFF))
    path.write_bytes(b"".join(out))
    return path


WRITERS = {
    "nmea": (nmea, "boat.nmea"),
    "nmea_vtg": (partial(nmea, course="VTG"), "dateless.nmea"),
    "mcap": (partial(bag, without=("/log/twist",)), "mcap"),
    "sqlite3": (partial(bag, kind="sqlite3", without=("/log/twist",)), "sqlite3"),
    "ros1": (partial(bag, kind="ros1", without=("/log/twist",)), "one.bag"),
    "mcap_crc": (mcap_crc, "speed.mcap"),
    "ulog": (ulog, "flight.ulg"),
    "ardupilot": (dataflash, "flight.bin"),
    "tlog": (tlog, "flight.tlog"),
    "sbet": (sbet, "mission.sbet"),
    "pd0": (pd0, "dvl.pd0"),
}
