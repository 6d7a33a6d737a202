"""A new effect needs numbers worked out by hand: its id must be in an oracle's test."""

from pathlib import Path

import pytest

from ahrs_service.effects.catalogue import EFFECTS

ORACLES = "".join(
    path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("test_*_oracles.py")
)


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.id)
def test_it_is_worked_out_by_hand(effect):
    named = f'"{effect.id}"' in ORACLES, f'f"{{triad}}_{effect.name}"' in ORACLES
    assert any(named), f"write an oracle for {effect.id} in tests/effects/test_..._oracles.py"
