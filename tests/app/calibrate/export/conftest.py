"""A unit to export, and an autopilot at a real link to take it."""

import asyncio
from contextlib import asynccontextmanager

import numpy as np
import pytest

from ahrs_service.app import cli
from ahrs_service.app.files import calibration_file
from ahrs_service.links.logs.param_files import ParamValue
from ahrs_service.links.logs.parameter_values import ARDUPILOT, PX4
from ahrs_service.links.simulated.autopilot_parameters import (
    AutopilotParameters,
    ardupilot_ins,
    px4_calibration,
)
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from tests.hang import HANG_S


def unit(**fields):
    """A unit with drift of both triads and, in no autopilot's model, scale over temperature."""
    breaks = np.linspace(-10.0, 60.0, 15)

    def curve(size):
        return Curve.through(
            breaks,
            lambda t: size * np.column_stack([np.sin(t / 20.0), (t - 25.0) / 30.0, 0.0 * t]),
        )

    drift = np.zeros((2, 9))
    drift[1, 4] = 0.004
    return Calibration(
        gyro=TriadCalibration(bias=(0.004, -0.002, 0.001), c=curve(0.006)),
        accel=TriadCalibration(
            matrix=((1.01, 0.002, 0.0), (0.0, 0.99, 0.0), (0.0, 0.0, 1.002)),
            bias=(0.1, -0.2, 0.3),
            c=curve(0.08),
            matrix_drift=Curve.linear((-10.0, 60.0), drift),
        ),
        serial="A7",
        **fields,
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to work in, with unit.toml."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ahrs_service.links.component.parameter_client.ANSWER_S", 0.03)
    monkeypatch.setattr("ahrs_service.links.component.parameter_client.SILENCE_S", 0.3)
    monkeypatch.setattr("ahrs_service.links.component.parameter_client.VEHICLE_S", HANG_S)
    calibration_file.save("unit.toml", unit())
    return tmp_path


@asynccontextmanager
async def autopilot(live, folder, kind="udpout", number=ARDUPILOT, limits=None):
    values = px4_calibration() if number == PX4 else ardupilot_ins()
    # Not as new: something that a backup must keep.
    first = "CAL_ACC0_XOFF" if number == PX4 else "INS_ACCOFFS_X"
    values[first] = ParamValue(0.0625)
    vehicle = await live.Vehicle(kind, folder).prepare()
    far = live.FarAutopilot(AutopilotParameters(values, number, limits), number, vehicle)
    beat = asyncio.create_task(far.beat())
    try:
        yield far
    finally:
        beat.cancel()
        await vehicle.close()


async def command(*words):
    async with asyncio.timeout(HANG_S):
        return await asyncio.to_thread(cli.main, ["calibrate", *map(str, words)])


def run(scenario):
    asyncio.run(scenario)


def text_of(capsys):
    out = capsys.readouterr()
    return " ".join((out.out + out.err).split())
