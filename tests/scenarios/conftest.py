"""Recordings edited frame by frame, and their replays."""

import copy
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.live.daemon import Daemon
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.estimator import Estimator
from ahrs_service.health import HealthMonitor
from ahrs_service.links.logs.readings import from_message
from ahrs_service.links.logs.tlog import read_tlog, tlog_record
from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from ahrs_service.records import READING_DTYPE, empty
from ahrs_service.rotation import inverse_columns, multiply_columns, rotate_columns
from ahrs_service.settings import LinkSettings, RecorderSettings, Settings

IMU = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU")
TICK_S = 0.05
CALM_S = {"simulated": 2.2, "copter": 34.0, "px4": 15.0}
"""From here on the vehicle hardly rotates for some seconds."""
REAL = {
    "copter": ("copter_quad106_50hz_reencoded.tlog", 480.0, 530.0),
    "px4": ("px4_auavx2_quad_250hz_reencoded.tlog", 5.0, 35.0),
}
"""Real recordings and the stretch of them [s]."""


@dataclass
class Frame:
    """One frame; `t_s` is the time of receipt since the recording's first frame."""

    t_s: float
    received_us: int
    data: bytes
    message: object = None

    @property
    def name(self):
        return "" if self.message is None else self.message.get_type()

    @property
    def is_imu(self):
        return self.name in IMU


def pack(message, system, component, sequence=0):
    """The MAVLink 2 frame of `message` as this sender packs it."""
    encoder = Encoder(system, component)
    encoder._link.seq = sequence
    # Packing writes the sender into the message.
    return encoder.pack(copy.copy(message))


@dataclass
class Outcome:
    """A replay and what can be asked of it; `t_s` [N] time of receipt since the first frame."""

    result: object
    start_us: int
    estimator: Estimator
    t_s: np.ndarray = field(init=False)

    def __post_init__(self):
        self.t_s = (self.estimates["received_ns"] // 1000 - self.start_us) * 1e-6

    @property
    def estimates(self):
        return self.result.estimates

    @property
    def summary(self):
        return self.result.summary

    @property
    def bytes(self):
        return self.estimates.tobytes()

    def counters(self):
        """What the estimator counted by time stamps."""
        names = ("gaps", "duplicates", "reordered", "clock_jumps")
        return {name: int(self.estimator.state[name][0]) for name in names}

    def new_flags(self, original):
        """Samples by flag, as far as there are more of them than in the unedited recording."""
        before = original.summary.flags
        more = {name: n - before.get(name, 0) for name, n in self.summary.flags.items()}
        return {name: n for name, n in more.items() if n}

    def when(self, flag):
        """Times at which a flag was set [s]."""
        return self.t_s[(self.estimates["flags"] & flag) != 0]

    def with_flag(self, flag):
        """The estimates that carry a flag."""
        return self.estimates[(self.estimates["flags"] & flag) != 0]

    def tilt_from(self, other, start_s=0.0, stop_s=math.inf):
        """Largest angle between both attitudes' verticals for the samples they share [deg]."""
        mine, theirs = self._shared(other, start_s, stop_s)
        down = np.broadcast_to([0.0, 0.0, 1.0], (len(mine), 3))
        a, b = (rotate_columns(inverse_columns(q), down) for q in (mine, theirs))
        angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1))
        return float(np.degrees(angles.max()))

    def is_as(self, other, start_s=0.0, stop_s=math.inf):
        """Whether both have the same attitudes to the last bit."""
        mine, theirs = self._shared(other, start_s, stop_s)
        return mine.tobytes() == theirs.tobytes()

    def turn_from(self, other, start_s=0.0, stop_s=math.inf):
        """Largest angle of the whole rotation between both attitudes [deg]."""
        mine, theirs = self._shared(other, start_s, stop_s)
        q = multiply_columns(inverse_columns(mine), theirs)
        angles = 2.0 * np.arctan2(np.linalg.norm(q[:, 1:], axis=1), abs(q[:, 0]))
        return float(np.degrees(angles.max()))

    def _shared(self, other, start_s, stop_s):
        mine = self.estimates[(self.t_s >= start_s) & (self.t_s < stop_s)]
        stamps = other.estimates["received_ns"]
        _, i, j = np.intersect1d(mine["received_ns"], stamps, return_indices=True)
        assert len(i) > 5, "the recordings share no samples in this window"
        return mine["ned_from_body"][i], other.estimates["ned_from_body"][j]

    def health(self):
        """(time [s], sentence) as the live service would have said, asked every tick."""
        monitor, said, now_s = HealthMonitor(), [], 0.0
        for n, t_s in enumerate(self.t_s.tolist()):
            while now_s < t_s:
                self._ask(monitor, now_s, said)
                now_s += TICK_S
            monitor.sample(self.estimates[n], t_s)
        self._ask(monitor, now_s, said)
        return said

    @staticmethod
    def _ask(monitor, now_s, said):
        if sentence := monitor.update(True, now_s):
            said.append((now_s, sentence))


class Recorded:
    """A recording in memory; every edit gives another one and leaves this as it is."""

    def __init__(self, frames, folder, vehicle, name):
        self.frames = frames
        self.vehicle = vehicle
        self.name = name
        self.calm_s = CALM_S[name]
        self._folder = folder
        self.start_us = frames[0].received_us

    @classmethod
    def read(cls, path, folder, name, start_s=0.0, stop_s=math.inf):
        """Read a stretch of a tlog; it begins with the first heartbeat of its autopilot."""
        tlog = read_tlog(path)
        decoder, frames, vehicle, first_us = Decoder(), [], None, None
        for row in tlog.frames:
            begin = int(row["offset"])
            stamp_us = int(row["received_us"]) & ~3
            first_us = stamp_us if first_us is None else first_us
            if not start_s <= (stamp_us - first_us) * 1e-6 < stop_s:
                continue
            data = tlog.data[begin : begin + int(row["length"])].tobytes()
            ((message, _),) = decoder.feed(data)
            if vehicle is None and message.get_type() == "HEARTBEAT":
                vehicle = (message.get_srcSystem(), message.get_srcComponent())
                begin_us = stamp_us
            if vehicle is not None:
                frames.append(Frame((stamp_us - begin_us) * 1e-6, stamp_us, data, message))
        return cls(frames, folder, vehicle, name)

    def _with(self, frames):
        return Recorded(frames, self._folder, self.vehicle, self.name)

    @property
    def duration_s(self):
        """Time from the first frame to the last."""
        return self.frames[-1].t_s

    def edit(self, rewrite: Callable[[Frame], Iterable[Frame]], start_s=0.0, stop_s=math.inf):
        """Replace each frame from `start_s` to `stop_s` by the result of `rewrite`."""
        out = []
        for frame in self.frames:
            out.extend(rewrite(frame) if start_s <= frame.t_s < stop_s else (frame,))
        return self._with(out)

    def drop(self, names, start_s=0.0, stop_s=math.inf):
        """Leave messages out."""
        return self.edit(lambda frame: [] if frame.name in names else [frame], start_s, stop_s)

    def change(self, names, alter, start_s=0.0, stop_s=math.inf, count=None):
        """Call `alter(message)` on copies of the messages named, at most `count`; pack anew."""
        left = [math.inf if count is None else count]

        def rewrite(frame):
            if frame.name not in names or left[0] <= 0:
                return [frame]
            left[0] -= 1
            return [self.altered(frame, alter)]

        return self.edit(rewrite, start_s, stop_s)

    @staticmethod
    def altered(frame, alter):
        """A frame whose message went through `alter`, from the same sender at the same time."""
        message = copy.copy(frame.message)
        alter(message)
        data = pack(message, message.get_srcSystem(), message.get_srcComponent(), message.get_seq())
        return Frame(frame.t_s, frame.received_us, data, message)

    def shift_clock(self, seconds, start_s, stop_s=math.inf):
        """Move the sender's clock in every message that carries it."""

        def alter(message):
            if hasattr(message, "time_usec"):
                message.time_usec += round(seconds * 1e6)
            if hasattr(message, "time_boot_ms"):
                message.time_boot_ms += round(seconds * 1e3)

        names = {
            frame.name
            for frame in self.frames
            if hasattr(frame.message, "time_usec") or hasattr(frame.message, "time_boot_ms")
        }
        return self.change(names, alter, start_s, stop_s)

    def insert(self, make: Callable[[Frame], Iterable[bytes]], start_s=0.0, stop_s=math.inf):
        """Put further bytes, frames or not, behind frames."""

        def rewrite(frame):
            more = (Frame(frame.t_s, frame.received_us, data) for data in make(frame))
            return [frame, *more]

        return self.edit(rewrite, start_s, stop_s)

    # -- what the service makes of it ---------------------------------------------------------

    def write(self, tail=b""):
        """Write it as a .tlog; bytes that are no frame get no stamp."""
        path = self._folder / f"{len(list(self._folder.iterdir()))}.tlog"
        path.write_bytes(
            b"".join(
                tlog_record(frame.received_us, frame.data) if frame.data[0] == 0xFD else frame.data
                for frame in self.frames
            )
            + tail
        )
        return path

    def replay(self, settings=None, tail=b""):
        """Replay it; for real recordings the frames must give the same when they come singly."""
        result = replay_log(self.write(tail), settings)
        if self.name in REAL:
            estimator = self.live(settings)
        else:
            estimator = Estimator(settings or Settings())
            estimator.take(result.recording.readings)
        assert estimator.digest.hexdigest() == result.summary.digest
        return Outcome(result, self.start_us, estimator)

    def live(self, settings=None):
        """The estimator after all frames were given one by one, each decoded from its bytes."""
        estimator, rows = Estimator(settings or Settings()), empty(READING_DTYPE, 1)
        decoder = Decoder(datagrams=True)
        for frame in self.frames:
            for message, _ in decoder.feed(frame.data):
                if from_message(message, frame.received_us * 1000, rows):
                    estimator.take(rows)
        return estimator

    def through_daemon(self):
        """A daemon that was given all bytes and recorded them, and the recording's path."""
        path = self._folder / f"{len(list(self._folder.iterdir()))}-session.tlog"
        settings = Settings(
            link=LinkSettings(uri="udpin:127.0.0.1:0"),
            recorder=RecorderSettings(directory=str(path)),
        )
        daemon = Daemon(settings, lambda level, text: None)
        daemon._open_outputs()
        for frame in self.frames:
            daemon._on_bytes(frame.data, frame.received_us, ("127.0.0.1", 1))
        daemon._close_outputs()
        return daemon, path


@pytest.fixture(scope="session")
def _simulated(simulated_tlog, tmp_path_factory):
    return Recorded.read(simulated_tlog, tmp_path_factory.mktemp("simulated"), "simulated")


@pytest.fixture(scope="session")
def _originals():
    return {}


@pytest.fixture(params=["simulated", *REAL])
def base(request, _simulated, _originals, tmp_path_factory):
    """The recording to edit: the simulated flight, and real ones where they are."""
    if request.param == "simulated":
        return _simulated
    if request.param not in _originals:
        shared: Path = request.getfixturevalue("shared")
        name, start_s, stop_s = REAL[request.param]
        path = shared / "flights" / name
        if not path.is_file():
            pytest.skip(f"no recording flights/{name} in ../shared/data")
        folder = tmp_path_factory.mktemp(request.param)
        read = Recorded.read(path, folder, request.param, start_s, stop_s)
        _originals[request.param] = read
    return _originals[request.param]


@pytest.fixture
def flight(_simulated):
    """The simulated flight: HIGHRES_IMU 200 Hz, RAW_IMU 50 Hz, SCALED_IMU 10 Hz."""
    return _simulated


@pytest.fixture
def unedited(request):
    """The outcome of a recording without edits, replayed once a session."""
    known = request.getfixturevalue("_originals")

    def of(recorded):
        key = id(recorded)
        if key not in known:
            known[key] = recorded.replay()
        return known[key]

    return of


@pytest.fixture
def packed():
    """`packed(message, system, component)`: the frame of a message."""
    return pack


@pytest.fixture
def messages():
    """The dialect, to make messages from."""
    return dialect
