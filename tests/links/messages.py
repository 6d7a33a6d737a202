"""Messages of an autopilot, recordings of them, and an estimate to publish."""

from pathlib import Path
from typing import Any

from ahrs_service.links.logs.tlog import tlog_record
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.records import ESTIMATE_DTYPE, Phase, empty

ARDUPILOT, INVALID = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, dialect.MAV_AUTOPILOT_INVALID
START_US = 1_700_000_000_000_000
AUTOPILOT = Encoder(1, 1)


def highres(updated: int = 0x1FFF, number: int = 0, **changed: float) -> Any:
    message = dialect.MAVLink_highres_imu_message(
        5_000_000, 1.0, 2.0, -9.5, 0.1, 0.2, 0.3, 0.25, 0.0, 0.5, 0, 0, 0, 31.5, updated, number
    )
    for name, value in changed.items():
        setattr(message, name, value)
    return message


def scaled(kind: str = "scaled_imu", temperature: int = 3150, **changed: int) -> Any:
    make = getattr(dialect, f"MAVLink_{kind}_message")
    message = make(7000, 100, -200, -1000, 10, -20, 30, 250, 0, -500, temperature=temperature)
    for name, value in changed.items():
        setattr(message, name, value)
    return message


def attitude(time_boot_ms: int, roll: float, pitch: float = 0.1, yaw: float = 0.2) -> Any:
    return dialect.MAVLink_attitude_message(time_boot_ms, roll, pitch, yaw, 0, 0, 0)


def heartbeat(autopilot: int = ARDUPILOT, kind: int = dialect.MAV_TYPE_FIXED_WING) -> Any:
    return dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)


def write(path: Path, *entries: Any) -> Path:
    """A tlog of messages, one millisecond apart; (encoder, message) for another sender."""
    content = b""
    for i, entry in enumerate(entries):
        encoder, message = entry if isinstance(entry, tuple) else (AUTOPILOT, entry)
        content += tlog_record(START_US + 1000 * i, encoder.pack(message))
    path.write_bytes(content)
    return path


def gps(fix: int = 3, vel: int = 1234, cog: int = 21_000, **changed: int) -> Any:
    message = dialect.MAVLink_gps_raw_int_message(
        9_000_000, fix, 474_000_000, 85_500_000, 0, 90, 140, vel, cog, 12
    )
    for name, value in changed.items():
        setattr(message, name, value)
    return message


def parameter(name: bytes, value: float) -> Any:
    return dialect.MAVLink_param_value_message(name, value, 9, 900, 17)


def estimate() -> Any:
    """A first estimate of a level vehicle, as the component publishes it."""
    row = empty(ESTIMATE_DTYPE)[0]
    row["phase"], row["ned_from_body"] = Phase.RUNNING, [1.0, 0.0, 0.0, 0.0]
    for name in ("rate_rad_s", "residual_m_s2", "attitude_sigma_rad"):
        row[name] = 0.0
    return row
