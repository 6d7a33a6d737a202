"""The Python code of the front page, run as written, one block after the other."""

import re
from pathlib import Path

import numpy as np

README = Path(__file__).resolve().parent.parent / "README.md"
BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def test_ten_lines_each():
    assert len(BLOCKS) == 3
    for block in BLOCKS:
        assert len([line for line in block.splitlines() if line.strip()]) <= 10


def test_it_runs(simulated_tlog, tmp_path, monkeypatch, capsys):
    still = {"gyr": np.zeros((500, 3)), "acc": np.tile([0.0, 0.0, -9.81], (500, 1))}
    np.savez(tmp_path / "samples.npz", **still, mag=np.tile([20.0, 0.0, 40.0], (500, 1)))
    for name in ("flight.tlog", "bench.tlog"):
        (tmp_path / name).symlink_to(simulated_tlog)
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "front_page"}
    for block in BLOCKS:
        exec(compile(block, str(README), "exec"), names)
    assert names["attitude"].quat.shape == names["attitude"].quat9.shape == (500, 4)
    np.testing.assert_allclose(names["q"], [1.0, 0.0, 0.0, 0.0], atol=1e-3)
    rows, verdict = capsys.readouterr().out.splitlines()
    assert rows == f"{len(names['table']['time_ns'])} rows, ['roll_rad', 'pitch_rad', 'yaw_rad']"
    assert verdict in ("no_mismatch", "explained", "unexplained")
