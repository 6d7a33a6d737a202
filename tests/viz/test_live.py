"""The live stream: hosted on loopback, bounded, the same columns as a replay, whole at the end."""

import socket
import subprocess
import sys

import numpy as np
import pytest

from ahrs_service.errors import ViewerError
from ahrs_service.records import READING_DTYPE, empty
from ahrs_service.viz import batch, entities
from ahrs_service.viz.live import LiveViewer

HTTP2_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
SETTINGS_FRAME = 4

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")


@pytest.fixture
def port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def feed(viewer, rows, step=13):
    for start in range(0, len(rows), step):
        viewer.estimate(rows[start : start + step])


def test_live_and_replay_write_the_same_columns(tmp_path, flight, read):
    reference = [(int(row["time_ns"]), row["ned_from_body"].copy()) for row in flight[::8]]
    viewer = LiveViewer(0, tmp_path / "live.rrd", period_s=0.001)
    viewer.start()
    for i, row in enumerate(flight):
        viewer.estimate(flight[i : i + 1])
        if i % 8 == 0:
            viewer.reference(int(row["time_ns"]), row["ned_from_body"])
    viewer.close()
    assert (viewer.error, viewer.dropped) == ("", 0)

    class Theirs:
        name = "autopilot"
        time_ns = np.array([stamp for stamp, _ in reference])
        ned_from_body = np.array([attitude for _, attitude in reference])

    batch.write_rrd(tmp_path / "replay.rrd", flight, [Theirs])
    live, replay = read(tmp_path / "live.rrd"), read(tmp_path / "replay.rrd")
    assert live.keys() - replay.keys() == {"/drops/viewer"}
    assert replay.keys() <= live.keys()
    for entity, table in replay.items():
        np.testing.assert_array_equal(live[entity].t, table.t, err_msg=entity)
        assert repr(live[entity].cells) == repr(table.cells), entity


def test_live_and_replay_show_the_same_raw_values(tmp_path, flight, read):
    readings = empty(READING_DTYPE, len(flight))
    readings["gyro_rad_s"], readings["accel_m_s2"] = flight["rate_rad_s"], 2.0
    viewer = LiveViewer(0, tmp_path / "live.rrd", period_s=0.001, shows_sensor=True)
    viewer.start()
    # A calibration applied in flight: before it nothing is shown.
    for i in range(len(flight)):
        viewer.estimate(flight[i : i + 1], readings[i : i + 1] if i >= 500 else None)
    viewer.close()
    assert (viewer.error, viewer.dropped) == ("", 0)
    batch.write_rrd(tmp_path / "replay.rrd", flight, readings=readings)
    live, replay = read(tmp_path / "live.rrd"), read(tmp_path / "replay.rrd")
    for entity in (entities.RAW_RATE, entities.USED_FORCE, entities.FORCE_CORRECTION):
        shown, whole = (tables[entity].numbers("Scalars:scalars") for tables in (live, replay))
        np.testing.assert_array_equal(shown, whole[500:], err_msg=entity)
        np.testing.assert_array_equal(live[entity].t, replay[entity].t[500:], err_msg=entity)


def test_a_full_queue_drops_the_oldest_and_says_so(tmp_path, flight, read):
    viewer = LiveViewer(0, tmp_path / "live.rrd", queue=10)
    feed(viewer, flight[:25], step=5)
    assert viewer.dropped == 15
    viewer.start()
    viewer.close()
    tables = read(tmp_path / "live.rrd")
    np.testing.assert_array_equal(
        tables[entities.RESIDUAL].numbers("Scalars:scalars"), flight["residual_m_s2"][15:25]
    )
    assert tables["/drops/viewer"].numbers("Scalars:scalars").ravel().tolist() == [15.0]


def test_the_row_is_copied(tmp_path, flight, read):
    viewer = LiveViewer(0, tmp_path / "live.rrd")
    row = flight[:1].copy()
    viewer.estimate(row)
    row["residual_m_s2"] = 99.0
    viewer.start()
    viewer.close()
    shown = read(tmp_path / "live.rrd")[entities.RESIDUAL].numbers("Scalars:scalars")
    np.testing.assert_array_equal(shown, flight["residual_m_s2"][:1])


def test_everything_else_it_is_reported(tmp_path, flight, read):
    viewer = LiveViewer(0, tmp_path / "live.rrd")
    feed(viewer, flight)
    viewer.temperature("board", int(flight["time_ns"][10]), 41.5)
    viewer.rates({"RAW_IMU": 199.0})
    viewer.drops({"bad CRC": 2})
    viewer.log("WARN", "link lost")
    viewer.start()
    viewer.close()
    assert viewer.error == ""
    tables = read(tmp_path / "live.rrd")
    now = int(flight["time_ns"][-1] - flight["time_ns"][0])
    assert tables["/temperature/board"].t.tolist() == [50_000_000]
    assert tables["/rates/RAW_IMU"].t.tolist() == [now]
    assert tables["/drops/bad\\ CRC"].numbers("Scalars:scalars").ravel().tolist() == [2.0]
    assert tables[entities.LOG].t.tolist() == [now]
    assert tables[entities.LOG].cells["TextLog:text"] == [["link lost"]]


def test_a_port_in_use_is_named(port):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        with pytest.raises(ViewerError, match=rf"port {port} .*another viewer port"):
            LiveViewer(port).start()


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ViewerError, match=r"nowhere.live\.rrd: No such file"):
        LiveViewer(0, tmp_path / "nowhere" / "live.rrd").start()


def test_it_answers_on_loopback_and_outlives_bad_clients(tmp_path, flight, read, port):
    viewer = LiveViewer(port, tmp_path / "live.rrd", period_s=0.01)
    viewer.start()
    assert viewer.ready.wait(30.0)
    assert viewer.uri == f"rerun+http://127.0.0.1:{port}/proxy"
    with socket.create_connection(("127.0.0.1", port), 10.0) as client:
        client.sendall(HTTP2_PREFACE)
        assert client.recv(9)[3] == SETTINGS_FRAME
        feed(viewer, flight[:600])
    silent = [socket.create_connection(("127.0.0.1", port), 10.0) for _ in range(3)]
    silent[0].sendall(b"\xff" * 4096)
    feed(viewer, flight[600:])
    viewer.close()
    for client in silent:
        client.close()
    assert viewer.error == ""
    assert len(read(tmp_path / "live.rrd")[entities.RESIDUAL].t) == len(flight)


def test_the_port_is_free_again_after_close(port):
    for _ in range(2):
        viewer = LiveViewer(port)
        viewer.start()
        assert viewer.ready.wait(30.0)
        viewer.close()
        assert viewer.error == ""


def test_closing_what_never_started_does_nothing():
    LiveViewer(0).close()


def test_rerun_is_not_imported_until_the_thread_runs():
    code = "import sys; from ahrs_service.viz import live; live.LiveViewer(9876); "
    code += "sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
