"""Codes for no measurement: which numbers are some, and which are samples."""

import numpy as np
import pytest

from bayes_sensor.io.readers.fill_codes import without_fill_codes

SIGNAL = [0.1, 0.4, 0.2, 0.9]


def left_out(*numbers: float) -> tuple[list[int], list[str]]:
    """Places of the samples left out, and the remarks."""
    y = np.array(numbers)
    found, remarks = without_fill_codes(y, lambda i: f"row {i}")
    kept = np.isfinite(found)
    np.testing.assert_array_equal(found[kept], y[kept])
    return [int(i) for i in np.flatnonzero(~kept)], remarks


@pytest.mark.parametrize(
    "code",
    [-99.0, 99.0, -9999.0, -999.99, 99999.0, -32768.0, 32767.0, 65535.0, -(2.0**31), 2.0**31 - 1,
     2.0**32 - 1],
)  # fmt: skip
def test_nines_and_the_ends_of_counters_are_codes(code: float) -> None:
    places, (remark,) = left_out(*SIGNAL, code, code)
    assert places == [4, 5] and remark.startswith(f"2 samples are {code:g}") and "row 4" in remark


@pytest.mark.parametrize("value", [-9.0, 98.0, -9998.0, 990.0, 32768.0, 1e4, -1e30])
def test_other_numbers_are_samples(value: float) -> None:
    assert left_out(*SIGNAL, value) == ([], [])


def test_a_code_lies_further_from_all_samples_than_they_from_each_other() -> None:
    assert left_out(0.0, 50.0, 98.0, 99.0) == ([], [])
    assert left_out(0.0, 49.0, 99.0)[0] == [2]
    assert left_out(0.0, 50.0, 99.0)[0] == []
    assert left_out(-99.0, 0.0, 99.0)[0] == []  # each lies as far from the middle as the other
    assert left_out(-9999.0, 0.0, 0.5, 99.0)[0] == [0, 3]  # and then the other
    assert left_out(99.0, 99.0, 99.0) == ([], [])  # nothing else to compare with
    assert left_out(0.3, 99.0) == ([], [])


def test_what_is_not_a_number_counts_as_nothing() -> None:
    assert left_out(np.nan, *SIGNAL, -9999.0)[0] == [0, 5]
    assert left_out(np.nan, np.nan)[1] == []
