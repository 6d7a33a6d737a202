"""A thermal session on a real socket: it ends by itself, and its recording agrees."""

import asyncio
import json
import os
import subprocess

from ahrs_service.app.cli import main
from tests.app.calibrate.test_calibrate_session import COMMAND, ROOT, fly, free_port, until
from tests.app.calibrate.test_calibrate_thermal import warm_up
from tests.hang import HANG_S


def test_a_session_ends_at_the_span_and_finds_what_its_recording_says(tmp_path, capsys):
    port, tlog, out = free_port(), tmp_path / "warm.tlog", tmp_path / "A1.toml"
    words = ["thermal", "--span", "30", "--rate", "5", "--record", str(tlog), "--json"]
    process = subprocess.Popen(
        [*COMMAND, *words, "--link", f"udpin:127.0.0.1:{port}", "--out", str(out)],
        cwd=ROOT,
        env={**os.environ, "XDG_STATE_HOME": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        said, _ = until(process.stderr.fileno(), rb"listening")
        asyncio.run(fly(warm_up(-10.0, 50.0), port, process, 40.0))
        stdout, stderr = process.communicate(timeout=HANG_S)
    finally:
        process.kill()
    said = (said + stderr).decode()
    assert process.returncode == 0, said
    assert "next: leave it alone while it warms or cools" in said
    assert "next: all is there" in said
    live = json.loads(stdout)
    assert live["usable"]
    low, high = live["verdict"]["triads"][0]["span_degc"]
    assert 29.0 < high - low < 45.0
    assert main(["calibrate", "thermal", str(tlog), "--json"]) == 0
    offline = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (live.pop("wrote"), offline.pop("wrote")) == (str(out), None)
    assert live == offline
