"""A written .rrd holds every estimate, value for value."""

from dataclasses import dataclass

import numpy as np
import pytest

from ahrs_service.records import READING_DTYPE, Gate, Phase, empty
from ahrs_service.rotation import euler_columns
from ahrs_service.settings import GateSettings
from ahrs_service.viz import batch, entities


@dataclass(frozen=True)
class Reference:
    name: str
    time_ns: np.ndarray
    ned_from_body: np.ndarray


@pytest.fixture
def written(tmp_path, flight, read):
    reference = Reference("EKF", flight["time_ns"][::8].copy(), flight["ned_from_body"][::8].copy())
    other = Reference("AHRS 2", flight["time_ns"][:50].copy(), flight["ned_from_body"][:50].copy())
    path, shares = tmp_path / "flight.rrd", []
    start = int(flight["time_ns"][0])
    batch.write_rrd(
        path,
        flight,
        [reference, other],
        temperatures={"board": ([start, start + 10**9], [30.0, 31.5])},
        rates={"RAW_IMU": ([start + 10**9], [200.0])},
        drops={"bad CRC": ([start + 2 * 10**9], [3])},
        messages=[(start + 10**9, "INFO", "aligned"), (start, "WARN", "low rate")],
        gate=GateSettings(norm_m_s2=0.25),
        progress=shares.append,
    )
    return path, read(path), shares


def test_series_are_the_estimates_in_degrees_and_si(written, flight):
    tables = written[1]
    elapsed = flight["time_ns"] - flight["time_ns"][0]
    euler = np.degrees(euler_columns(flight["ned_from_body"]))
    euler[:, 2] %= 360.0
    bias = np.degrees(flight["gyro_bias_rad_s"])
    sigma = np.degrees(flight["gyro_bias_sigma_rad_s"])
    expected = {
        "/attitude/ours": euler,
        entities.SIGMA: np.degrees(flight["attitude_sigma_rad"]),
        entities.RESIDUAL: flight["residual_m_s2"],
        entities.INNOVATION: np.degrees(flight["innovation_rad"]),
        entities.BIAS: np.concatenate([bias, bias - sigma, bias + sigma], axis=1),
    }
    for entity, values in expected.items():
        table = tables[entity]
        np.testing.assert_array_equal(table.t, elapsed, err_msg=entity)
        np.testing.assert_array_equal(table.numbers("Scalars:scalars"), values, err_msg=entity)


def test_gate_load_is_a_share_of_the_given_limits(written, flight):
    load = written[1][entities.LOAD].numbers("Scalars:scalars")
    limits = GateSettings()
    np.testing.assert_array_equal(load[:, 0], flight["gate_norm_m_s2"] / 0.25)
    np.testing.assert_array_equal(load[:, 1], flight["gate_rate_rad_s"] / limits.rate_rad_s)
    np.testing.assert_array_equal(load[:, 3], flight["gate_innovation"] / limits.innovation_sigma)
    assert (load[:, 4] == 1.0).all()


def test_states_change_where_the_gate_changes_and_name_the_reasons(written):
    gate = written[1][entities.GATE]
    ms = np.arange(1200) * 5
    ms[900:] += 800
    expected = [
        (0, "aligning"),
        (ms[200], "open"),
        (ms[400], "closed: norm"),
        (ms[450], "closed: norm + rate"),
        (ms[470], "closed: norm + saturation"),
        (ms[480], "open"),
        (ms[899] + 0.001, "gap"),
        (ms[900], "open"),
    ]
    texts = [cell[0] for cell in gate.cells["StateChange:state"]]
    assert list(zip(gate.t / 1e6, texts, strict=True)) == expected
    samples = written[1][entities.SAMPLE]
    assert [cell[0] for cell in samples.cells["StateChange:state"]] == [
        "good",
        "gap + spike",
        "good",
    ]
    assert samples.t.tolist() == [0, int(ms[900] * 1e6), int(ms[901] * 1e6)]


def test_scene_is_the_first_row_of_each_40_ms(written, flight):
    scene = written[1][entities.OURS]
    elapsed = flight["time_ns"] - flight["time_ns"][0]
    _, first = np.unique(elapsed // 40_000_000, return_index=True)
    np.testing.assert_array_equal(scene.t, elapsed[first])
    wxyz = flight["ned_from_body"][first]
    turned = scene.numbers("Transform3D:quaternion")[:, 0]
    np.testing.assert_allclose(turned, wxyz[:, [1, 2, 3, 0]], atol=1e-7)
    force = scene.numbers("Arrows3D:vectors")[:, 0]
    np.testing.assert_allclose(force, flight["accel_m_s2"][first] * (-2.6 / 9.80665), atol=1e-6)
    trusted = (flight["gate"][first] == Gate.OPEN) & (flight["phase"][first] == Phase.RUNNING)
    colours = scene.numbers("Arrows3D:colors")[:, 0]
    assert set(colours[trusted]) == {0x2FA35CFF}
    assert set(colours[~trusted]) == {0xD8343FFF}


def test_world_is_rotated_for_the_nose_to_point_ahead(written, flight):
    """Heading-up: world_from_ned * ned_from_body has no yaw left."""
    from ahrs_service.rotation import multiply_columns

    world = written[1][entities.NED].numbers("Transform3D:quaternion")[:, 0][:, [3, 0, 1, 2]]
    elapsed = flight["time_ns"] - flight["time_ns"][0]
    _, first = np.unique(elapsed // 40_000_000, return_index=True)
    euler = euler_columns(multiply_columns(world, flight["ned_from_body"][first]))
    tilt = euler_columns(flight["ned_from_body"][first])[:, :2]
    np.testing.assert_allclose(euler[:, 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(euler[:, :2], tilt, atol=1e-6)


def test_what_goes_with_the_estimates(written, flight, static):
    path, tables, shares = written
    elapsed = flight["time_ns"] - flight["time_ns"][0]
    np.testing.assert_array_equal(tables["/attitude/theirs"].t, elapsed[::8])
    assert len(tables["/attitude/AHRS\\ 2"].t) == 50
    assert tables["/temperature/board"].numbers("Scalars:scalars").ravel().tolist() == [30.0, 31.5]
    assert tables["/rates/RAW_IMU"].t.tolist() == [10**9]
    assert tables["/drops/bad\\ CRC"].numbers("Scalars:scalars").ravel().tolist() == [3.0]
    log = tables[entities.LOG]
    assert [cell[0] for cell in log.cells["TextLog:text"]] == ["low rate", "aligned"]
    assert [cell[0] for cell in log.cells["TextLog:level"]] == ["WARN", "INFO"]
    imu = tables["/temperature/IMU\\ used"]
    _, first = np.unique(elapsed // 10**9, return_index=True)
    np.testing.assert_array_equal(
        imu.numbers("Scalars:scalars")[:, 0], flight["temperature_degc"][first]
    )
    used = tables["/rates/samples\\ used"]
    assert used.t.tolist() == elapsed[first][1:].tolist()
    rate = np.diff(first) * 1e9 / np.diff(elapsed[first])
    np.testing.assert_array_equal(used.numbers("Scalars:scalars")[:, 0], rate)
    assert shares[-1] == 1.0
    assert "Mesh3D:vertex_positions" in static(path)[f"{entities.THEIRS}/airframe"]


def test_chunks_make_no_difference(tmp_path, flight, read, monkeypatch):
    batch.write_rrd(tmp_path / "whole.rrd", flight)
    monkeypatch.setattr(batch, "_CHUNK", 7)
    batch.write_rrd(tmp_path / "pieces.rrd", flight)
    whole, pieces = read(tmp_path / "whole.rrd"), read(tmp_path / "pieces.rrd")
    assert whole.keys() == pieces.keys()
    for entity, table in whole.items():
        np.testing.assert_array_equal(table.t, pieces[entity].t, err_msg=entity)
        assert repr(table.cells) == repr(pieces[entity].cells), entity


def test_without_a_reference_there_is_no_ghost(tmp_path, flight, read, static):
    batch.write_rrd(tmp_path / "alone.rrd", flight)
    assert "/attitude/theirs" not in read(tmp_path / "alone.rrd")
    assert f"{entities.THEIRS}/airframe" not in static(tmp_path / "alone.rrd")


def test_no_estimates_make_a_whole_file(tmp_path, flight, read):
    batch.write_rrd(tmp_path / "none.rrd", flight[:0], messages=[(5, "ERROR", "no IMU")])
    assert list(read(tmp_path / "none.rrd")) == [entities.LOG]


def test_rows_that_are_not_numbers_leave_the_scene_alone(tmp_path, flight, read):
    flight["ned_from_body"][:100] = np.nan
    flight["accel_m_s2"][200] = np.nan
    batch.write_rrd(tmp_path / "nan.rrd", flight)
    tables = read(tmp_path / "nan.rrd")
    assert tables[entities.OURS].t[0] == flight["time_ns"][104] - flight["time_ns"][0]
    assert len(tables["/attitude/ours"].t) == len(flight)
    assert np.isfinite(tables[entities.OURS].numbers("Arrows3D:vectors")).all()


def test_a_folder_that_is_not_there_is_named(tmp_path, flight):
    with pytest.raises(OSError, match="nowhere"):
        batch.write_rrd(tmp_path / "nowhere" / "flight.rrd", flight)


def test_trust_is_reported_for_each_second(tmp_path, flight, read):
    flight["gate"] = Gate.OPEN
    flight["gate"][400:600] = Gate.NORM
    flight["gate"][600:750] = Gate.RATE
    batch.write_rrd(tmp_path / "trust.rrd", flight)
    trust = read(tmp_path / "trust.rrd")[entities.TRUST]
    texts = [cell[0] for cell in trust.cells["StateChange:state"]]
    assert list(zip(trust.t / 1e9, texts, strict=True)) == [
        (0.0, "trusted"),
        (2.0, "not trusted"),
        (3.0, "partly trusted"),
        (4.0, "trusted"),
    ]


def with_readings(flight):
    """The sensor's raw reading for each estimate, with a bias."""
    readings = empty(READING_DTYPE, len(flight))
    readings["time_ns"] = flight["time_ns"]
    readings["gyro_rad_s"] = flight["rate_rad_s"] + 0.1
    readings["accel_m_s2"] = flight["accel_m_s2"] - 0.2
    return readings


def test_raw_values_stand_beside_compensated_where_readings_are_given(tmp_path, flight, read):
    readings = with_readings(flight)
    path = tmp_path / "flight.rrd"
    batch.write_rrd(path, flight, readings=readings)
    tables = read(path)
    rate, force = np.degrees(flight["rate_rad_s"]), flight["accel_m_s2"]
    expected = {
        entities.RAW_RATE: np.degrees(readings["gyro_rad_s"]),
        entities.USED_RATE: rate,
        entities.RATE_CORRECTION: np.full(rate.shape, np.degrees(0.1)),
        entities.RAW_FORCE: readings["accel_m_s2"],
        entities.USED_FORCE: force,
        entities.FORCE_CORRECTION: np.full(force.shape, -0.2),
    }
    for entity, values in expected.items():
        shown = tables[entity].numbers("Scalars:scalars")
        np.testing.assert_allclose(shown, values, atol=1e-12, err_msg=entity)
    batch.write_rrd(path, flight)
    assert not set(expected) & set(read(path))
