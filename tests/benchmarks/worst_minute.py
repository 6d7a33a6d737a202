"""The worst minute of each flight, and what happened in it, so that its cause can be named."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from peers import G0
from rich.table import Table
from tilt_witness import gyro_corrections

from ahrs_service.attitude_interpolation import at_instants
from ahrs_service.links.logs.recording import AttitudeReference
from ahrs_service.records import Gate, Rows
from ahrs_service.rotation import euler_columns

MINUTE_S = 60.0
STEP_S = 5.0
LEAST_SHARE = 0.5
"""A minute counts if at least this share of the usual number of instants was compared."""


@dataclass(frozen=True)
class Minute:
    """What the table says of one minute; angles [deg], rates [deg/s], biases [mrad/s]."""

    start_s: float
    tilt: float
    peer_tilt: float
    mean_error: tuple[float, float]
    bank: float
    rate: float
    force: float
    airspeed: float
    open_share: float
    bias_change: tuple[float, float, float]
    reference: float
    reference_usual: float


def _errors(rows: Rows, reference: AttitudeReference) -> tuple[Any, Any]:
    """Roll and pitch errors [M, 2] [deg], and where there are any."""
    ours, found = at_instants(rows, reference.time_ns, reference.ned_from_body)
    theirs = euler_columns(reference.ned_from_body)
    apart = (euler_columns(ours) - theirs)[:, :2]
    return np.degrees(np.arctan2(np.sin(apart), np.cos(apart))), found


def worst_minute(samples: Rows, ours: Rows, peer: Rows, reference: AttitudeReference) -> Minute:
    """The minute with the largest rms of roll and pitch errors together, and what happens there."""
    origin = samples["time_ns"][0]
    at_s = (reference.time_ns - origin) * 1e-9
    error, found = _errors(ours, reference)
    starts = np.arange(at_s[found].min(), max(at_s[found].max() - MINUTE_S, 0.0) + STEP_S, STEP_S)
    inside = [found & (at_s >= start) & (at_s < start + MINUTE_S) for start in starts]
    usual = LEAST_SHARE * max(int(one.sum()) for one in inside)
    sizes = [
        float(np.sqrt((error[one] ** 2).sum(axis=1).mean())) if one.sum() >= usual else 0.0
        for one in inside
    ]
    worst = int(np.argmax(sizes))
    chosen, start_s = inside[worst], float(starts[worst])
    t_s = (samples["time_ns"] - origin) * 1e-9
    mine = (t_s >= start_s) & (t_s < start_s + MINUTE_S)
    there, rows = samples[mine], ours[mine]
    peer_error = _errors(peer, reference)[0][chosen]
    mean = error[chosen].mean(axis=0)
    change = 1e3 * (rows["gyro_bias_rad_s"][-1] - rows["gyro_bias_rad_s"][0])
    when_s, corrections = gyro_corrections(
        t_s, samples["gyro_rad_s"], at_s, reference.ned_from_body
    )
    then = (when_s >= start_s) & (when_s < start_s + MINUTE_S)
    speeds = there["airspeed_m_s"][np.isfinite(there["airspeed_m_s"])]
    bank = np.abs(euler_columns(reference.ned_from_body[chosen])[:, 0])
    return Minute(
        start_s=start_s,
        tilt=sizes[worst],
        peer_tilt=float(np.sqrt((peer_error**2).sum(axis=1).mean())),
        mean_error=(float(mean[0]), float(mean[1])),
        bank=float(np.degrees(bank.max())),
        rate=float(np.degrees(np.nanmean(np.linalg.norm(there["gyro_rad_s"], axis=1)))),
        force=float(np.nanmean(np.abs(np.linalg.norm(there["accel_m_s2"], axis=1) - G0))),
        airspeed=float(np.median(speeds)) if len(speeds) else np.nan,
        open_share=float((rows["gate"] == Gate.OPEN).mean()),
        bias_change=(float(change[0]), float(change[1]), float(change[2])),
        reference=_rms(corrections[then]),
        reference_usual=_rms(corrections),
    )


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def table(minutes: dict[str, tuple[str, Minute]]) -> Table:
    """One row per flight: where, how much, and what happened; the peer is the flight's best."""
    title = "Worst minute of ours (rms of roll and pitch errors together)"
    out = Table(title=title, title_justify="left", padding=(0, 1), show_edge=False)
    out.add_column("flight")
    for name in (
        "from s",
        "ours deg",
        "best peer deg",
        "mean roll, pitch",
        "bank max",
        "rate deg/s",
        "|f|-g m/s²",
        "airspeed",
        "open %",
        "bias change mrad/s",
        "ref unseen by gyro deg/s (flight)",
    ):
        out.add_column(name, justify="right")
    for flight, (peer, one) in minutes.items():
        x, y, z = one.bias_change
        out.add_row(
            flight,
            f"{one.start_s:.0f}",
            f"{one.tilt:.2f}",
            f"{one.peer_tilt:.2f} {peer}",
            "{:+.1f} {:+.1f}".format(*one.mean_error),
            f"{one.bank:.0f}",
            f"{one.rate:.0f}",
            f"{one.force:.2f}",
            f"{one.airspeed:.0f}" if np.isfinite(one.airspeed) else "-",
            f"{100.0 * one.open_share:.0f}",
            f"{x:+.1f} {y:+.1f} {z:+.1f}",
            f"{one.reference:.2f} ({one.reference_usual:.2f})",
        )
    return out
