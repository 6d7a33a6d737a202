"""The GPS smoother on a recording: an attitude to judge by, and where it may be believed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from flight_recordings import Flight
from gps_smoother import LAG, GpsSmoother, Smoothed
from gps_velocity import GpsVelocity
from peers import Floats
from tilt_witness import carried

from ahrs_service.records import Integers, Rows

USUAL_LAG_S = 0.1
SETTLING_STEPS = 4
SURE_RAD = np.radians(1.0)
NEAR_S = 1.0
"""So far from a fix the reference is still believed; the gyro holds the attitude that long."""


@dataclass(frozen=True)
class GpsReference:
    """Attitudes [N, 4] and 1-sigma of their tilt [N] at the samples; `valid` [N] where to use them.

    `smoother` can be asked again (other noise, fixes left out) with `attitudes` as the start.
    """

    t_s: Floats
    attitudes: Floats
    sigma_rad: Floats
    valid: Any
    smoother: GpsSmoother
    smoothed: Smoothed
    lag_s: float


def usable(samples: Rows) -> Any:
    """Mark [N] the samples that are finite and later than all before."""
    good = np.isfinite(samples["gyro_rad_s"]).all(axis=1)
    good &= np.isfinite(samples["accel_m_s2"]).all(axis=1)
    newest = np.maximum.accumulate(samples["time_ns"])
    good[1:] &= samples["time_ns"][1:] > newest[:-1]
    return good


def gps_reference(
    time_ns: Integers, gyro: Floats, force: Floats, start: Floats, gps: GpsVelocity
) -> GpsReference:
    """Smooth samples [N] at rising `time_ns` from a first guess `start` [N, 4] on."""
    origin = time_ns[0]
    t_s, fix_s = ((one - origin) * 1e-9 for one in (time_ns, gps.time_ns))
    height = np.where(np.isnan(gps.ned_m_s[:, 2]), gps.height_m, np.nan)
    fix = np.concatenate([gps.ned_m_s, height[:, None]], axis=1)
    first = GpsSmoother(t_s, gyro, force, fix_s, fix, USUAL_LAG_S)
    settled = first.smooth(start, steps=SETTLING_STEPS)
    lag_s = USUAL_LAG_S + float(settled.state[-1, LAG])
    smoother = GpsSmoother(t_s, gyro, force, fix_s, fix, lag_s)
    one = smoother.smooth(start)
    sigma = np.interp(t_s, one.t_s, one.sigma_rad)
    after = np.clip(np.searchsorted(one.t_s, t_s), 1, len(one.t_s) - 1)
    near = np.minimum(np.abs(t_s - one.t_s[after - 1]), np.abs(one.t_s[after] - t_s)) < NEAR_S
    near &= ~smoother.new[after]
    return GpsReference(
        t_s, smoother.attitude(one), sigma, near & (sigma < SURE_RAD), smoother, one, lag_s
    )


def smoothed(flight: Flight, gps: GpsVelocity) -> tuple[GpsReference, Floats]:
    """Return the GPS's reference at the usable samples, and the flight's own attitude [N, 4] there.

    That is where the smoother begins.
    """
    samples, reference = flight.samples[usable(flight.samples)], flight.reference
    stamps, gyro = samples["time_ns"], samples["gyro_rad_s"]
    t_s, at_s = ((one - stamps[0]) * 1e-9 for one in (stamps, reference.time_ns))
    order = np.argsort(at_s, kind="stable")
    order = order[np.concatenate([[True], np.diff(at_s[order]) > 0.0])]
    start = carried(t_s, gyro, at_s[order], reference.ned_from_body[order])
    return gps_reference(stamps, gyro, samples["accel_m_s2"], start, gps), start
