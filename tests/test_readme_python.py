"""The Python that the front page shows, run as it stands."""

import re
from pathlib import Path

import pytest

README = Path(__file__).resolve().parent.parent / "README.md"
BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def test_three_things_are_shown():
    assert len(BLOCKS) == 3


@pytest.mark.parametrize("block", BLOCKS, ids=["arrays", "live", "log"])
def test_it_runs(block, simulated_tlog, tmp_path, monkeypatch, capsys):
    (tmp_path / "flight.tlog").symlink_to(simulated_tlog)
    monkeypatch.chdir(tmp_path)
    assert len([line for line in block.splitlines() if line.strip()]) <= 10
    exec(compile(block, str(README), "exec"), {"__name__": "front_page"})
    assert capsys.readouterr().out.strip()
