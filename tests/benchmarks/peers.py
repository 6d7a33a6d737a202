"""Other attitude filters behind one function, so that all get the same samples.

Run: python tests/benchmarks/peers.py      checks each against a tumble whose truth is known

`attitude(name, gyr, acc, t, mag)` takes sensor axes forward-left-up, specific force [m/s^2] (level
at rest: z = +9.81), and gives wxyz quaternions [N, 4] that turn sensor axes into earth axes with z
up: east-north-up where a magnetometer is given, any heading where not. Every filter is causal and
runs with one fixed setting; a sample that is not finite or does not move time on is not shown to
it. Needs the extra `bench`: pip install -e '.[bench]'
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import ahrs
import imufusion
import numpy as np
import numpy.typing as npt
import vqf

PROJECT = Path(__file__).resolve().parents[2]
SHARED_DATA = PROJECT.parent / "shared" / "data"
G0 = 9.80665
LONGEST_STEP_S = 0.5

Floats = npt.NDArray[np.float64]
Filter = Callable[[Floats, Floats, Floats, Floats | None], Floats]


def require_data(folder: Path, contents: str) -> Path:
    """Return `folder`; leave with advice where it is missing."""
    if not folder.is_dir():
        raise SystemExit(
            f"{folder} is not there: give --data DIR with {contents}; the MANIFEST.md of the "
            "project's shared data names the public source and commit of every file"
        )
    return folder


def multiply(p: Floats, q: Floats) -> Floats:
    """Hamilton products [N, 4]."""
    pw, px, py, pz = np.moveaxis(np.broadcast_to(p, q.shape), -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def frd_attitude(q: Floats) -> Floats:
    """Turn attitudes [N, 4] (z-up from forward-left-up) into (z-down from forward-right-down)."""
    return q * np.array([1.0, 1.0, -1.0, -1.0])


def flu_from_frd(vectors: Floats) -> Floats:
    """Turn vectors [N, 3] in forward-right-down axes into forward-left-up ones, or back."""
    return np.ascontiguousarray(vectors * np.array([1.0, -1.0, -1.0]))


def _steps(t: Floats) -> tuple[float, Floats]:
    """The usual step [s], and the step before each sample; after a long gap the usual one."""
    steps = np.diff(t)
    usual = float(steps[steps < LONGEST_STEP_S].mean())
    return usual, np.concatenate([[usual], np.where(steps < LONGEST_STEP_S, steps, usual)])


def _vqf(kind: Any, **settings: float) -> Filter:
    def run(gyr: Floats, acc: Floats, t: Floats, mag: Floats | None) -> Floats:
        usual, steps = _steps(t)
        # It knows only steps of one length: a rate scaled to that length turns as far.
        scaled = gyr * (steps / usual)[:, None]
        out = kind(usual, **settings).updateBatch(scaled, acc, mag)
        return np.asarray(out["quat6D" if mag is None else "quat9D"], np.float64)

    return run


def _fusion(gain: float, rejection_deg: float, with_bias: bool) -> Filter:
    def run(gyr: Floats, acc: Floats, t: Floats, mag: Floats | None) -> Floats:
        usual, steps = _steps(t)
        settings = imufusion.AhrsSettings()
        settings.convention = imufusion.CONVENTION_ENU
        settings.sample_rate = 1.0 / usual
        settings.gain = gain
        if rejection_deg > 0.0:
            settings.acceleration_rejection = settings.magnetic_rejection = rejection_deg
            settings.rejection_timeout = 5.0
        one = imufusion.Ahrs()
        one.set_settings(settings)
        bias = imufusion.Bias()
        bias_settings = imufusion.BiasSettings()
        bias_settings.sample_rate = 1.0 / usual
        bias.set_settings(bias_settings)
        deg_s, g = np.degrees(gyr), acc / G0
        out = np.empty((len(t), 4))
        for n, step in enumerate(steps.tolist()):
            rate = bias.update(deg_s[n]) if with_bias else deg_s[n]
            one.set_sample_period(step)
            if mag is None:
                one.update_no_magnetometer(rate, g[n])
            else:
                one.update(rate, g[n], mag[n])
            out[n] = one.get_quaternion()
        return out

    return run


def _first_attitude(acc: Floats, mag: Floats | None) -> Floats:
    """East-north-up attitude [4] of gravity and field; north along the sensor's y without one."""
    up = acc / np.linalg.norm(acc)
    north = mag if mag is not None else np.array([0.0, 1.0, 0.0])
    if mag is None and abs(up[1]) > 0.9:
        north = np.array([1.0, 0.0, 0.0])
    east = np.cross(north, up)
    east /= np.linalg.norm(east)
    rows = np.array([east, np.cross(up, east), up])
    return np.asarray(ahrs.Quaternion(dcm=rows).to_array(), np.float64)


def _step_by_step(make: Callable[[bool], Any], earth_from_enu: Floats) -> Filter:
    """A filter of `ahrs`; its own earth axes are turned from east-north-up by a quaternion."""

    def run(gyr: Floats, acc: Floats, t: Floats, mag: Floats | None) -> Floats:
        _, steps = _steps(t)
        one = make(mag is not None)
        turn = earth_from_enu if mag is not None else np.array([1.0, 0.0, 0.0, 0.0])
        q = multiply(turn, _first_attitude(acc[0], None if mag is None else mag[0])[None])[0]
        out = np.empty((len(t), 4))
        for n, step in enumerate(steps.tolist()):
            if mag is None:
                q = one.updateIMU(q, gyr[n], acc[n], dt=step)
            else:
                q = one.updateMARG(q, gyr[n], acc[n], mag[n], dt=step)
            out[n] = q
        return multiply(turn * np.array([1.0, -1.0, -1.0, -1.0]), out)

    return run


def _madgwick(nine: bool) -> Any:
    # Its own default gain goes by the data given to the constructor.
    return ahrs.filters.Madgwick(gain=0.041 if nine else 0.033)


_SAME: Final = np.array([1.0, 0.0, 0.0, 0.0])
_NWU_FROM_ENU: Final = np.array([math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5)])

PEERS: Final[dict[str, Filter]] = {
    "vqf": _vqf(vqf.VQF),
    "vqf tauAcc 10": _vqf(vqf.VQF, tauAcc=10.0),
    "BasicVQF": _vqf(vqf.BasicVQF),
    "BasicVQF tauAcc 10": _vqf(vqf.BasicVQF, tauAcc=10.0),
    "Fusion": _fusion(0.5, 0.0, False),
    "Fusion gain .5 rej 10": _fusion(0.5, 10.0, False),
    "Fusion gain .1 rej 5": _fusion(0.1, 5.0, False),
    "Fusion gain .1 rej 5 bias": _fusion(0.1, 5.0, True),
    "Mahony .1/.0005": _step_by_step(lambda nine: ahrs.filters.Mahony(k_P=0.1, k_I=0.0005), _SAME),
    "Madgwick": _step_by_step(_madgwick, _NWU_FROM_ENU),
}
"""Name in the tables and filter, each with one fixed setting; unnamed settings are its own."""


def attitude(name: str, gyr: Floats, acc: Floats, t: Floats, mag: Floats | None = None) -> Floats:
    """Run one peer over samples [N, 3], [N, 3], times [N] [s]; see the module for the frames."""
    usable = np.isfinite(gyr).all(axis=1) & np.isfinite(acc).all(axis=1) & np.isfinite(t)
    if mag is not None:
        usable &= np.isfinite(mag).all(axis=1)
    newest = np.maximum.accumulate(np.where(usable, t, -np.inf))
    usable[1:] &= t[1:] > newest[:-1]
    chosen = [np.ascontiguousarray(one[usable], np.float64) for one in (gyr, acc, t)]
    field = None if mag is None else np.ascontiguousarray(mag[usable], np.float64)
    out = np.tile(_SAME, (len(t), 1))
    answer = PEERS[name](*chosen, field)
    last = np.cumsum(usable) - 1
    out[last >= 0] = answer[last[last >= 0]]
    return out


def inclination(estimate: Floats, reference: Floats) -> Floats:
    """Tilt error [N] [rad] of one attitude against another, whatever the heading."""
    e = multiply(estimate, reference * np.array([1.0, -1.0, -1.0, -1.0]))
    return np.asarray(2.0 * np.arccos(np.minimum(np.hypot(e[:, 0], e[:, 3]), 1.0)))


def total(estimate: Floats, reference: Floats) -> Floats:
    """Angle [N] [rad] from one attitude to another."""
    e = multiply(estimate, reference * np.array([1.0, -1.0, -1.0, -1.0]))
    return np.asarray(2.0 * np.arccos(np.minimum(np.abs(e[:, 0]), 1.0)))


def tumble(seconds: float = 60.0, rate_hz: float = 200.0) -> dict[str, Floats]:
    """A tumble about all axes without acceleration, and its exact attitude, east-north-up.

    The rate is constant over each step, so the attitude is exact; a field of 20 uT north, 40 down.
    """
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    rate = np.stack([1.2 * np.sin(0.9 * t), 0.8 * np.sin(0.61 * t + 1.0), np.cos(0.37 * t)], axis=1)
    rate[t < 5.0] = 0.0
    q = np.empty((len(t), 4))
    now = _first_attitude(np.array([1.0, 2.0, 9.0]), np.array([14.0, 9.0, -40.0]))
    for n, turn in enumerate(rate / rate_hz):
        angle = float(np.linalg.norm(turn))
        axis = turn / angle if angle > 0.0 else turn
        step = np.array([math.cos(0.5 * angle), *(math.sin(0.5 * angle) * axis)])
        now = multiply(now, step[None])[0]
        q[n] = now
    up, field = _in_sensor(q, [0.0, 0.0, 1.0]), _in_sensor(q, [0.0, 20.0, -40.0])
    return {"t": t, "gyr": rate, "acc": G0 * up, "mag": field, "quat": q}


def _in_sensor(q: Floats, vector: list[float]) -> Floats:
    inverse = q * np.array([1.0, -1.0, -1.0, -1.0])
    pure = np.broadcast_to(np.array([0.0, *vector]), q.shape)
    return multiply(multiply(inverse, pure), q)[:, 1:]


def main() -> int:
    """Print the largest errors of every peer on the tumble; 1 if a frame must be wrong."""
    truth = tumble()
    settled = truth["t"] > 20.0
    wrong = 0
    for name in PEERS:
        six = attitude(name, truth["gyr"], truth["acc"], truth["t"])
        nine = attitude(name, truth["gyr"], truth["acc"], truth["t"], truth["mag"])
        tilt = np.degrees(inclination(six, truth["quat"])[settled]).max()
        angle = np.degrees(total(nine, truth["quat"])[settled]).max()
        # A wrong axis or sign shows as tens of degrees.
        good = tilt < 3.0 and angle < 5.0
        wrong += not good
        verdict = "" if good else "   WRONG FRAME?"
        print(f"{name:28} six axes: tilt {tilt:6.3f} deg   nine: {angle:6.3f} deg{verdict}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
