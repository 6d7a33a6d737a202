"""Does the reported 1-sigma cover the error on real flights? Against the logs' own attitude.

The tilt from our attitude to the reference's, about the estimated north and east, in the sigmas
reported there: within 1 and 2 sigma for 68 and 95 % of the instants, where sigma is right and the
reference is the truth. It is not, so its own error is in these figures too: reference_witness.py
says by which share, rest_witness.py how far it moves on the ground, where our sigma is smallest.
Flight is told by the gyro alone, as in ahrs_service.comparison.
"""

import math
from dataclasses import dataclass

import numpy as np
from error_angle import error_angle
from flight_recordings import Flight
from flights import DEFAULT_MODE, ours
from rich.table import Table

from ahrs_service.attitude_interpolation import at_instants
from ahrs_service.comparison import FLOWN_RATE_RAD_S, motion
from ahrs_service.records import Floats


@dataclass(frozen=True)
class Coverage:
    """NEES per axis, shares within 1 and 2 sigma, rms and sigma [deg] over `count` instants."""

    count: int
    nees: float
    covered: tuple[float, float]
    rms_deg: float
    sigma_deg: float


def _of(tilt: Floats, sigma: Floats) -> Coverage:
    if not len(tilt):
        return Coverage(0, math.nan, (math.nan, math.nan), math.nan, math.nan)
    ratio = np.abs(tilt) / sigma
    rms, mean_sigma = (math.degrees(math.sqrt(np.mean(v**2))) for v in (tilt, sigma))
    covered = float(np.mean(ratio < 1.0)), float(np.mean(ratio < 2.0))
    return Coverage(len(tilt), float(np.mean(ratio**2)), covered, rms, mean_sigma)


def coverage(flight: Flight, aided: bool) -> tuple[Coverage, Coverage]:
    """Return what holds in flight and on the ground."""
    rows, reference = ours(flight.samples, DEFAULT_MODE, aided), flight.reference
    attitude, found = at_instants(rows, reference.time_ns, reference.ned_from_body)
    _, wobble = motion(rows, reference.time_ns)
    flown = wobble[found] > FLOWN_RATE_RAD_S
    tilt = error_angle(reference.ned_from_body[found], attitude[found], 6)[:, :2]
    order = np.argsort(rows["time_ns"], kind="stable")
    after = np.searchsorted(rows["time_ns"][order], reference.time_ns[found])
    place = order[np.minimum(after, len(order) - 1)]
    sigma = rows["attitude_sigma_rad"][place, :2]
    return _of(tilt[flown], sigma[flown]), _of(tilt[~flown], sigma[~flown])


def coverage_table(results: dict[str, tuple[Coverage, Coverage, Coverage]]) -> Table:
    """Return the table of all flights: six axes in flight, aided in flight, on the ground."""
    title = "Real flights, against the log's own attitude: NEES: share within 1 and 2 sigma"
    out = Table(title=title)
    out.add_column("flight", no_wrap=True)
    for heading in (
        "in flight",
        "rms",
        "sigma",
        "aided, in flight",
        "rms",
        "sigma",
        "on the ground",
    ):
        out.add_column(heading, justify="right", no_wrap=True)
    for name, (flown, aided, grounded) in results.items():
        out.add_row(
            name,
            *(_share(flown), f"{flown.rms_deg:.2f}", f"{flown.sigma_deg:.2f}"),
            *(_share(aided), f"{aided.rms_deg:.2f}", f"{aided.sigma_deg:.2f}"),
            _share(grounded),
        )
    return out


def _share(one: Coverage) -> str:
    if not one.count:
        return "-"
    return f"{one.nees:.2f}: {100 * one.covered[0]:.0f}, {100 * one.covered[1]:.0f} %"
