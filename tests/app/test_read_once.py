"""Each command scans a recording only once, whatever it needs from it."""

from pathlib import Path

import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.files import config_file
from ahrs_service.links.logs import dataflash_tables, tlog, ulog
from ahrs_service.links.logs.session_marks import MarkKind, mark_messages
from ahrs_service.links.logs.tlog import read_tlog, tlog_record
from ahrs_service.links.mavlink.codec import Encoder
from ahrs_service.settings import Settings


@pytest.fixture
def scans(monkeypatch):
    """The files scanned, as often as they are: whatever name a reader is imported by."""
    found = []

    def spy(module, name):
        real = getattr(module, name)

        def counting(path, *rest):
            found.append(Path(path).name)
            return real(path, *rest)

        monkeypatch.setattr(module, name, counting)

    spy(tlog, "_read")
    spy(ulog, "read_tables")
    monkeypatch.setattr(
        dataflash_tables.np,
        "fromfile",
        lambda path, *rest, real=dataflash_tables.np.fromfile: (
            found.append(Path(path).name),
            real(path, *rest),
        )[1],
    )
    return found


@pytest.fixture(scope="module")
def own(simulated_tlog, tmp_path_factory):
    """Fifteen seconds of a recording of this service: it begins with its settings."""
    log = read_tlog(simulated_tlog)
    stop = log.frames["received_us"] < log.frames["received_us"][0] + 15_000_000
    end = int((log.frames["offset"] + log.frames["length"])[stop][-1])
    marks = [
        tlog_record(int(log.frames["received_us"][0]), Encoder(1, 191).pack(message))
        for message in mark_messages(MarkKind.SETTINGS, config_file.to_json(Settings()))
    ]
    path = tmp_path_factory.mktemp("own") / "own.tlog"
    path.write_bytes(b"".join(marks) + log.data[:end].tobytes())
    return path


@pytest.mark.parametrize(
    "words",
    [
        ("replay", "{log}"),
        ("replay", "{log}", "--tlog", "{out}"),
        ("diagnose", "{log}"),
        ("simulate", "--from", "{log}", "--tlog", "{out}"),
        ("calibrate", "noise", "{log}"),
        ("calibrate", "allan", "{log}"),
        ("calibrate", "thermal", "{log}"),
    ],
    ids=" ".join,
)
def test_a_tlog_is_scanned_once(words, own, scans, tmp_path, capsys):
    main([word.format(log=own, out=tmp_path / "out.tlog") for word in words])
    assert scans == ["own.tlog"], capsys.readouterr().err


@pytest.mark.parametrize("name", ["copter_pixhawk_log0039_temp.bin", "px4_auavx2_quad_250hz.ulg"])
def test_other_logs_are_scanned_once(name, shared, scans, tmp_path):
    path = shared / "flights" / name
    if not path.is_file():
        pytest.skip(f"{name} is not in ../shared/data/flights")
    main(["replay", str(path)])
    main(["simulate", "--from", str(path), "--tlog", str(tmp_path / "sim.tlog")])
    main(["calibrate", "noise", str(path)])
    assert scans == [name] * 3
