"""How well the calibration procedures find simulated sensors, and what they say of real benches.

    python tests/benchmarks/calibration_procedures.py
    python tests/benchmarks/calibration_procedures.py --data ../shared/data

First table: simulated benches of many seeds, each with another sensor of the small autopilot's
kind. `chi2/n` is the mean of error^T covariance^-1 error over the number of parameters, 1 where the
standard errors are honest; `in 1 s` the share of parameters within one standard error, 68 %. With
white noise alone the errors are those that the fit can know of; with the sensor's wandering
bias too ("all noise") they are what a user gets. Errors are RMS over seeds and elements; `before`
is the RMS of what the calibration is to find.

Other tables, of real recordings: noise coefficients and S() of the benches at rest; the rest phases
of the BROAD trials, and what the procedure for any poses says to them.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ahrs_service.app.calibrate.allan import coefficients, longest_still
from ahrs_service.app.calibrate.capture import read_capture
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.calibration import known_rotations, multi_pose, pose_rotations, six_position
from ahrs_service.calibration.allan import fit_coefficients
from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.noise import gate_noise
from ahrs_service.calibration.poses import directions, find_poses, groups_of
from ahrs_service.calibration.rate_table import Mounting, fit_encoder
from ahrs_service.calibration.triad import TriadFit
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats
from ahrs_service.sensor.parameters import TriadCalibration
from ahrs_service.settings import IntakeSettings
from ahrs_service.simulation.imu import Imu, consumer_grade
from ahrs_service.simulation.scenario import Flight, make_flight
from ahrs_service.simulation.table_swings import Swing, table_phases

RATE_HZ = 100.0
BENCHES = (
    "bench_copter_2021-11-23_static_44min_1hz.tlog",
    "bench_cuav_2021-12-08_static_warmup_2hz.tlog",
    "bench_cuavv5_2021-12-08.bin",
    "bench_matekh743_2021_isbd2khz_warmup.bin",
)

Result = tuple[TriadFit, Floats, Floats, list[int]]
"""Fit, true K and B, and which parameters are free (the others follow from them)."""

ALL = list(range(12))
SYMMETRIC = [0, 4, 8, 1, 2, 5, 9, 10, 11]


def sensor(seed: int, noisy: bool) -> Imu:
    """A sensor of the kind at its room temperature."""
    imu = replace(consumer_grade().sibling(np.random.default_rng([seed, 77])), propeller=None)
    plain = {
        name: TriadCalibration(matrix=triad.matrix, bias=triad.bias)
        for name, triad in (("gyro", imu.calibration.gyro), ("accel", imu.calibration.accel))
    }
    imu = replace(imu, calibration=replace(imu.calibration, **plain))
    if noisy:
        return imu
    return replace(
        imu,
        gyro_noise=replace(imu.gyro_noise, walk=0.0, wander=0.0),
        accel_noise=replace(imu.accel_noise, walk=0.0, wander=0.0),
    )


def columns_of(flight: Flight) -> ImuColumns:
    rows = flight.rows
    degc = rows["imu_degc"].astype(np.float64)
    return ImuColumns(rows["time_s"], rows["gyro_rad_s"], rows["accel_m_s2"], degc)


def truth_of(triad: TriadCalibration, turned: Floats | None = None) -> tuple[Floats, Floats]:
    matrix = np.array(triad.matrix)
    return (matrix if turned is None else matrix @ turned.T), np.array(triad.bias)


def from_six_positions(seed: int, noisy: bool) -> Iterator[tuple[str, Result]]:
    flight = make_flight("six-position", 120.0, seed, RATE_HZ, sensor(seed, noisy))
    columns, calibration = columns_of(flight), flight.calibration
    poses = find_poses(columns)
    accel = six_position.fit_accelerometer(poses)
    yield "six-position, accel", (accel, *truth_of(calibration.accel), ALL)
    turns = known_rotations.find_rotations(columns, poses, accel, 360.0)
    gyro = known_rotations.fit_gyro(poses, turns)
    yield "six-position, gyro by circles", (gyro, *truth_of(calibration.gyro), ALL)


def from_many_poses(seed: int, noisy: bool) -> Iterator[tuple[str, Result]]:
    flight = make_flight("multi-pose", 140.0, seed, RATE_HZ, sensor(seed, noisy))
    columns, calibration = columns_of(flight), flight.calibration
    poses = find_poses(columns)
    accel = multi_pose.fit_accelerometer(poses)
    # In the symmetric axes that the norm can know, both matrices are turned alike.
    u, _, vt = np.linalg.svd(np.array(calibration.accel.matrix))
    yield "multi-pose, accel", (accel, *truth_of(calibration.accel, u @ vt), SYMMETRIC)
    gyro = pose_rotations.fit_gyro(columns, poses, accel)
    yield "multi-pose, gyro by the turns", (gyro, *truth_of(calibration.gyro, u @ vt), ALL)


def from_encoder(seed: int, noisy: bool) -> Iterator[tuple[str, Result]]:
    imu = sensor(seed, noisy)
    phases, time_s = table_phases(40.0), np.arange(0.0, 40.0, 1.0 / RATE_HZ)
    mountings = []
    for k, axis in enumerate(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))):
        swing = Swing(axis)
        truth = swing.truth(phases, 0.0, time_s)
        warm = np.full(len(time_s), 25.0)
        rng = np.random.default_rng([seed, k])
        gyro, force = imu.measure(truth, warm, RATE_HZ, rng)
        columns = ImuColumns(time_s, gyro, force, warm)
        mountings.append(Mounting(axis, columns, time_s, truth["rate_rad_s"] @ swing.unit))
    fit, _ = fit_encoder(tuple(mountings))
    yield "rate-table, encoder", (fit, *truth_of(imu.calibration.gyro), ALL)


def simulated(seeds: int) -> None:
    print(f"simulated benches, {seeds} sensors: errors of what is found, RMS")
    head = ("procedure", "noise", "chi2/n", "in 1 s", "K [ppm]", "before", "B", "before")
    print("{:31}{:7}{:>8}{:>8}{:>9}{:>8}{:>10}{:>9}".format(*head))
    ways: tuple[Callable[[int, bool], Iterator[tuple[str, Result]]], ...] = (
        from_six_positions,
        from_many_poses,
        from_encoder,
    )
    for way in ways:
        for noisy in (False, True):
            found: dict[str, list[Result]] = {}
            for seed in range(seeds):
                for name, result in way(seed, noisy):
                    found.setdefault(name, []).append(result)
            for name, results in found.items():
                print(_line(name, "all" if noisy else "white", results))


def _line(name: str, noise: str, results: list[Result]) -> str:
    squares, inside, matrix, bias, matrix_before, bias_before = [], [], [], [], [], []
    for fit, true_matrix, true_bias, free in results:
        error = np.concatenate([(fit.matrix - true_matrix).ravel(), fit.bias - true_bias])[free]
        covariance = fit.covariance[np.ix_(free, free)]
        squares.append(error @ np.linalg.solve(covariance, error) / len(free))
        inside.append(np.abs(error) < np.sqrt(np.diag(covariance)))
        matrix.append(fit.matrix - true_matrix)
        bias.append(fit.bias - true_bias)
        matrix_before.append(true_matrix - np.eye(3))
        bias_before.append(true_bias)
    rms = [
        float(np.sqrt(np.mean(np.square(part))))
        for part in (matrix, matrix_before, bias, bias_before)
    ]
    return (
        f"{name:31}{noise:7}{np.mean(squares):8.2f}{np.mean(inside):8.0%}"
        f"{1e6 * rms[0]:9.0f}{1e6 * rms[1]:8.0f}{rms[2]:10.1e}{rms[3]:9.1e}"
    )


def benches(flights: Path) -> None:
    print("\nreal benches at rest: random walk N of gyro and accel (x, y, z), S() of the gate")
    for name in BENCHES:
        capture = read_capture(flights / name, IntakeSettings())
        still = longest_still(capture.columns)
        seconds = still.time_s[-1] - still.time_s[0]
        print(f"{name}: {capture.source} {capture.rate_hz:.0f} Hz, still for {seconds:.0f} s")
        for triad, axes in coefficients(still).items():
            walks = ", ".join(f"{a.random_walk:.1e}" for a in axes)
            floors = ", ".join(
                f"{a.bias_instability:.1e}" if a.is_seen("bias_instability") else "not seen"
                for a in axes
            )
            print(f"    {triad:6} N {walks}   B {floors}")
        try:
            gate = gate_noise(replay_log(capture.path).estimates)
            print(
                f"    S(): {gate.norm_sigma_m_s2:.1e} m/s^2, {gate.rate_sigma_rad_s:.1e} rad/s, "
                f"{gate.angular_acceleration_sigma_rad_s2:.1e} rad/s^2 ({gate.steady_s:.0f} s)"
            )
        except CalibrationError as error:
            print(f"    S(): refused: {error}")
        print("    multi-pose: " + _multi_pose(capture.columns))


def broad(folder: Path) -> None:
    print("\nBROAD, rest phases: force at rest, random walk of the gyro, multi-pose")
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as file:
            gyro, accel = file["imu_gyr"].astype(float), file["imu_acc"].astype(float)
            interval_s = 1.0 / float(file["sampling_rate"])
        time_s = np.arange(len(gyro)) * interval_s
        columns = ImuColumns(time_s, gyro, accel, np.full(len(gyro), np.nan))
        poses = find_poses(columns)
        pose = poses[np.argmax(poses["last"] - poses["first"])]
        still = columns.part(int(pose["first"]), int(pose["last"]))
        walk = [fit_coefficients(values, interval_s).random_walk for values in still.gyro_rad_s.T]
        norm = np.linalg.norm(poses["accel_m_s2"], axis=1)
        count = int(groups_of(directions(poses["accel_m_s2"])).max()) + 1
        print(
            f"{path.stem[:34]:34} {len(poses)} poses, {count} direction, norm {norm.min():.3f} to "
            f"{norm.max():.3f} m/s^2, N {np.mean(walk):.1e}: {_multi_pose(columns)[:60]}"
        )


def _multi_pose(columns: ImuColumns) -> str:
    """What the procedure for any poses finds or why not."""
    try:
        poses = find_poses(columns)
        triad = multi_pose.judge_accelerometer(poses, multi_pose.fit_accelerometer(poses))
    except CalibrationError as error:
        return f"refused: {error}"
    return f"held-out norm {triad.held_out_before:.3f}, after {triad.held_out_after:.3f} m/s^2"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder with flights/ and broad/")
    parser.add_argument("--seeds", type=int, default=40, help="simulated sensors")
    arguments = parser.parse_args()
    simulated(arguments.seeds)
    if arguments.data is not None:
        benches(arguments.data / "flights")
        broad(arguments.data / "broad")


if __name__ == "__main__":
    main()
