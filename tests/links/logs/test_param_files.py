import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.errors import ParamFileError
from ahrs_service.links.logs.param_files import (
    INT32,
    REAL32,
    ParamValue,
    read_param_file,
    write_param_file,
)
from ahrs_service.links.logs.parameter_values import rounded

NAMES = st.from_regex(r"[A-Z][A-Z0-9_]{0,15}", fullmatch=True)
FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)
INTEGERS = st.integers(-(2**31), 2**31 - 1)
QGC_VALUES = st.one_of(FLOATS.map(ParamValue), INTEGERS.map(lambda n: ParamValue(float(n), INT32)))


@pytest.mark.parametrize(
    ("dialect", "values"),
    [("mission-planner", FLOATS.map(ParamValue)), ("qgroundcontrol", QGC_VALUES)],
)
def test_what_is_written_reads_back_the_same(tmp_path_factory, dialect, values):
    @settings(deadline=None, max_examples=25)
    @given(st.dictionaries(NAMES, values, min_size=1, max_size=40))
    def check(parameters):
        path = tmp_path_factory.mktemp("params") / "out.param"
        write_param_file(path, parameters, dialect, ("made by a test",))
        back = read_param_file(path)
        assert {name: rounded(value) for name, value in back.items()} == parameters
        assert list(back) == list(parameters)
        for name, value in parameters.items():
            assert math.copysign(1.0, back[name].value) == math.copysign(1.0, value.value)

    check()


def test_a_file_of_mission_planner(tmp_path):
    path = tmp_path / "a.param"
    path.write_bytes(
        b"\xef\xbb\xbf#NOTE: 23.11.2021 12:40:19 bench\r\n"
        b"INS_ACCOFFS_X,-0.07477801\r\n"
        b"INS_ACC_ID,2753028\r\n\r\n"
        b"INS_TCAL1_ENABLE,1 # learnt on the bench\r\n"
    )
    assert read_param_file(path) == {
        "INS_ACCOFFS_X": ParamValue(-0.07477801),
        "INS_ACC_ID": ParamValue(2753028.0),
        "INS_TCAL1_ENABLE": ParamValue(1.0),
    }


def test_a_file_of_mavproxy(tmp_path):
    path = tmp_path / "a.parm"
    path.write_text("INS_ACCOFFS_X    -0.074778\nINS_GYR_CAL\t1.000000\n")
    assert read_param_file(path) == {
        "INS_ACCOFFS_X": ParamValue(-0.074778),
        "INS_GYR_CAL": ParamValue(1.0),
    }


def test_a_file_of_qgroundcontrol(tmp_path):
    path = tmp_path / "a.params"
    path.write_text(
        "# Onboard parameters for Vehicle 1\n#\n# Stack: PX4 Pro\n#\n"
        "# Vehicle-Id Component-Id Name Value Type\n"
        "1\t1\tCAL_ACC0_ID\t4259850\t6\n"
        "1\t1\tCAL_ACC0_XOFF\t-0.223573148250579834\t9\n"
    )
    assert read_param_file(path) == {
        "CAL_ACC0_ID": ParamValue(4259850.0, INT32),
        "CAL_ACC0_XOFF": ParamValue(-0.223573148250579834, REAL32),
    }


def test_qgroundcontrol_s_lines_as_written(tmp_path):
    path = tmp_path / "a.params"
    values = {"TC_A0_ID": ParamValue(4259850.0, INT32), "TC_A0_X1_0": ParamValue(np.float32(0.1))}
    write_param_file(path, values, "qgroundcontrol", ("ours",), 3, 1)
    assert path.read_text().splitlines() == [
        "# ours",
        "#",
        "# Vehicle-Id Component-Id Name Value Type",
        "3\t1\tTC_A0_ID\t4259850\t6",
        "3\t1\tTC_A0_X1_0\t0.1\t9",
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("A,1\nB,one\n", "line 2: B = 'one': give a finite number"),
        ("A,nan\n", "line 1: A = 'nan'"),
        ("A,inf\n", "line 1: A = 'inf'"),
        ("# only a comment\n\n", "holds no parameter"),
        ("A_NAME_OF_17_LETTERS,1\n", "line 1: 'A_NAME_OF_17_LETTERS' is not a parameter name"),
        ("A-B,1\n", "line 1: 'A-B' is not a parameter name"),
        ("A\n", "line 1: 'A' is not understood"),
        ("A,1,2\n", "line 1: 'A,1,2' is not understood"),
        ("A,1\nA,2\n", "line 2: A = 2.0 although it was 1.0 above"),
        ("1\t1\tA\t1\t99\n", "line 1: '99' is no MAV_PARAM_TYPE"),
        ("1\t1\tA\t1.5\t6\n", "line 1: A = '1.5': give a whole number"),
    ],
)
def test_a_wrong_line_is_named_with_its_number(tmp_path, text, words):
    path = tmp_path / "bad.param"
    path.write_text(text)
    with pytest.raises(ParamFileError) as error:
        read_param_file(path)
    assert str(error.value).startswith(str(path))
    assert words in str(error.value)


def test_what_is_no_text_or_not_there_is_reported(tmp_path):
    path = tmp_path / "bad.param"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(ParamFileError, match="is not text"):
        read_param_file(path)
    with pytest.raises(ParamFileError, match="No such file"):
        read_param_file(tmp_path / "none.param")
    with pytest.raises(ParamFileError, match="folder"):
        write_param_file(tmp_path / "no" / "a.param", {"A": ParamValue(1.0)}, "mission-planner")


def test_an_existing_file_is_not_overwritten(tmp_path):
    path = tmp_path / "a.param"
    write_param_file(path, {"A": ParamValue(1.0)}, "mission-planner")
    with pytest.raises(ParamFileError, match="already exists"):
        write_param_file(path, {"A": ParamValue(2.0)}, "mission-planner")
    assert read_param_file(path) == {"A": ParamValue(1.0)}
