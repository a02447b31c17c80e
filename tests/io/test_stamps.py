"""Written times in whole nanoseconds: midnight, offsets, dates of either order, long numbers."""

import numpy as np
import pytest

from bayes_sensor.io.readers.stamps import (
    LATEST_EPOCH,
    Stamps,
    epoch_unit,
    is_compact_number,
    read_long_numbers,
    read_moment,
    read_stamps,
)

SECOND = 1_000_000_000


def stamps(cells: list[str], dates: list[str] | None = None) -> Stamps:
    found = read_stamps(cells, dates)
    assert isinstance(found, Stamps)
    return found


def steps(cells: list[str]) -> list[float]:
    """s, between one cell and the next."""
    return [float(step) / SECOND for step in np.diff(stamps(cells).ns)]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["23:59:59", "00:00:01"], [2.0]),
        (["23:59:59", "00:00:01", "23:59:58", "00:00:00"], [2.0, 86397.0, 2.0]),
        # a sample that was written late, or a clock that was set back, is no midnight
        (["12:00:02", "12:00:01", "12:00:03"], [-1.0, 2.0]),
        (["14:00:00", "03:00:00"], [-39600.0]),
        (["15:00:00", "02:00:00"], [39600.0]),
        # minutes and seconds alone begin anew each hour
        (["59:59.5", "00:00.25"], [0.75]),
        (["10:05.0", "10:04.0"], [-1.0]),
    ],
)
def test_a_day_passes_where_the_clock_falls_by_more_than_half_of_one(
    cells: list[str], expected: list[float]
) -> None:
    assert steps(cells) == expected


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ("12:30:00 AM", 1800.0), ("12:30:00 PM", 45000.0), ("01:30:00 p.m.", 48600.0),
        ("2 days 01:00:00", 176400.0), ("2.01:00:00", 176400.0),
        ("00:00:00.123456789", 0.123456789),
        ("01.01.00 00:00:01", 946684801.0),
        ("1970-01-02 09:55", 86400.0 + 35700.0), ("09:55", 595.0),
        ("1970-01-01 02:30:00+02:30", 0.0), ("1970-01-01 01:00:00-01", 7200.0),
        ("19700101_000130", 90.0), ("20000101000130.5", 946684890.5),
    ],
)  # fmt: skip
def test_a_moment_in_seconds(cell: str, seconds: float) -> None:
    found = read_moment(cell)
    assert found is not None and found.ns == round(seconds * SECOND)


def test_an_offset_that_changes_is_counted_unless_only_its_label_does() -> None:
    day = "2024-03-31T"
    real = stamps([day + "01:59:59+01:00", day + "03:00:00+02:00", day + "03:00:01+02:00"])
    assert np.diff(real.ns).tolist() == [SECOND, SECOND] and real.relabelled is None
    label = stamps([day + "01:59:58+01:00", day + "01:59:59+01:00", day + "02:00:00+02:00"])
    assert np.diff(label.ns).tolist() == [SECOND, SECOND] and label.relabelled == 2
    # two samples at one time of day are no clock that goes on
    still = stamps([day + "01:00:00+00:00", day + "01:00:01+00:00", day + "01:00:01+01:00"])
    assert still.relabelled is None


@pytest.mark.parametrize(
    ("dates", "days"),
    [
        (["13/05/2024", "14/05/2024"], 1),  # no month has the number 13
        (["05/13/2024", "05/14/2024"], 1),
        (["03/04/2024", "03/05/2024"], 1),  # not a month, where it may be a day
        (["03/04/2024", "04/04/2024"], 1),
        (["30.01.2024", "30.03.2024"], 60),
        (["31.12.24", "01.01.25"], 1),
        (["24-03-05", "24-03-06"], 1),  # two digits of a year may stand first
        (["99/12/30", "99/12/31"], 1),
        (["05-Mar-2024", "Mar 7, 2024"], 2),
    ],
)
def test_the_order_of_a_date_is_the_one_in_which_the_least_time_passes(
    dates: list[str], days: int
) -> None:
    assert np.diff(stamps(["12:00:00", "12:00:00"], dates).ns).tolist() == [days * 86400 * SECOND]


def test_a_number_is_the_time_since_1970_by_its_size() -> None:
    found = [epoch_unit(1.7 * 10.0**power) for power in (9, 12, 15, 18)]
    assert [each[0] for each in found if each] == ["s", "ms", "us", "ns"]
    assert epoch_unit(45000.0) is None and epoch_unit(1e20) is None


def test_a_compact_number_has_a_date_and_a_time() -> None:
    assert is_compact_number("20240305090000") and not is_compact_number("20240305")
    assert not is_compact_number("20241305090000")  # no such month


def test_long_numbers_keep_their_last_digit() -> None:
    ns, numbers = read_long_numbers(["1700000000.123456789", "-1700000000,5"], 1.0)
    assert ns is not None and ns.tolist() == [1_700_000_000_123_456_789, -1_700_000_000_500_000_000]
    assert numbers[1] == -1.7e9 - 0.5
    assert read_long_numbers(["1", "x"], 1.0) == 1
    beyond, _ = read_long_numbers([str(LATEST_EPOCH * 1.01)], 1.0)
    assert beyond is None
