"""Prediction by a block without information on a number: a warm-up is in the first block."""

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.app.prove.blind_files import case_bytes
from ahrs_service.blind.making.case import Request, make
from ahrs_service.diagnosis.diagnose import diagnose


def test_a_warm_up_is_not_made_worse_by_blocks_that_do_not_show_it(tmp_path):
    path = tmp_path / "hidden.tlog"
    request = Request("hidden", "bench", 3503, 240, effects=("accel_warm_up",), level=2)
    path.write_bytes(case_bytes(make(request)))
    (finding,) = diagnose(read_columns(path)).findings
    assert finding.effect == "accel_warm_up"
    assert 0.0 < finding.holdout.log_likelihood_gain < 2.0 * finding.log_evidence
