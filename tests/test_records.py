"""Records: one layout, no holes, and the same bytes back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from ahrs_service import intake, pipeline
from ahrs_service.records import (
    ESTIMATE_DTYPE,
    READING_DTYPE,
    SAMPLE_DTYPE,
    Flag,
    Gate,
    ImuSource,
    Kind,
    Phase,
    empty,
)

RECORDS = {"reading": READING_DTYPE, "sample": SAMPLE_DTYPE, "estimate": ESTIMATE_DTYPE}
STATES = {"intake": intake.STATE_DTYPE, "pipeline": pipeline.STATE_DTYPE}
each_record = pytest.mark.parametrize("dtype", RECORDS.values(), ids=RECORDS)


@pytest.mark.parametrize("dtype", [*RECORDS.values(), *STATES.values()], ids=[*RECORDS, *STATES])
def test_layouts_have_no_holes_and_fields_are_aligned(dtype):
    assert sum(dtype[name].itemsize for name in dtype.names) == dtype.itemsize
    assert dtype.itemsize % 8 == 0
    for name in dtype.names:
        kind, offset = dtype.fields[name][:2]
        assert offset % kind.base.alignment == 0, name


@each_record
def test_layouts_do_not_depend_on_the_machine(dtype):
    for name in dtype.names:
        base = dtype[name].base
        assert base == base.newbyteorder("<"), name
        assert base.kind in "iuf"


@each_record
@given(count=st.integers(0, 20))
def test_empty_rows_hold_nan_for_numbers_and_zero_for_the_rest(dtype, count):
    rows = empty(dtype, count)
    assert rows.shape == (count,)
    assert rows.dtype == dtype
    for name in dtype.names:
        values = rows[name]
        assert np.isnan(values).all() if values.dtype.kind == "f" else not values.any()


@each_record
@given(data=st.data())
def test_bytes_come_back_as_the_same_rows(dtype, data):
    count = data.draw(st.integers(1, 4))
    bytes_ = data.draw(npst.arrays(np.uint8, (count * dtype.itemsize,))).tobytes()
    rows = np.frombuffer(bytes_, dtype)
    assert rows.tobytes() == bytes_
    copied = empty(dtype, count)
    for name in dtype.names:
        copied[name] = rows[name]
    # NaN payloads may not survive a copy; every other bit does.
    for name in dtype.names:
        np.testing.assert_array_equal(copied[name], rows[name])


def test_numbers_fit_their_columns():
    for members, dtype, column in (
        (Kind, READING_DTYPE, "kind"),
        (ImuSource, READING_DTYPE, "source"),
        (ImuSource, SAMPLE_DTYPE, "source"),
        (Flag, SAMPLE_DTYPE, "flags"),
        (Flag, ESTIMATE_DTYPE, "flags"),
        (Gate, ESTIMATE_DTYPE, "gate"),
        (Phase, ESTIMATE_DTYPE, "phase"),
    ):
        limit = np.iinfo(dtype[column]).max
        assert all(0 <= member <= limit for member in members), (members, column)


@pytest.mark.parametrize("members", [Flag, Gate])
def test_every_flag_is_a_bit_of_its_own(members):
    bits = [int(member) for member in members.__members__.values() if member]
    assert all(bit & (bit - 1) == 0 for bit in bits)
    assert len(set(bits)) == len(bits)


def test_sources_fit_the_intakes_tables():
    assert max(ImuSource) < intake.STATE_DTYPE["count"].shape[0]
