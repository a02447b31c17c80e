"""Times that contradict each other, and days taken as seconds, are remarked on."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io

from bayes_sensor.campaign import Campaign
from bayes_sensor.io.readers import read_campaign

T = np.arange(240) * 0.05
Y = np.clip(T - 2.0, 0.0, 1.0) - np.clip(T - 7.0, 0.0, 1.0)


def understood(file: Path, keys: str = "") -> Campaign:
    toml = file.with_name("campaign.toml")
    toml.write_text(
        f'[[experiment]]\nname = "1"\nfile = "{file.name}"\ntotal_flow = "4 L/min"\n'
        f'concentration = "10 %"\n{keys}'
    )
    return read_campaign(toml)


def written(folder: Path, suffix: str, other: Any, name: str) -> Path:
    """A file with the times T and, under a name that is time as well, others."""
    file = folder / f"a{suffix}"
    columns = {"t": T, "y": Y, name: other}
    if suffix == ".mat":
        scipy.io.savemat(file, columns)
    elif suffix == ".npz":
        np.savez(file, **columns)
    elif suffix == ".parquet":
        pd.DataFrame(columns).to_parquet(file)
    else:
        pd.DataFrame(columns).to_csv(file, index=False)
    return file


@pytest.mark.parametrize(
    ("suffix", "name", "other"),
    [
        (".csv", "elapsed_s", 2.0 * T),
        (".parquet", "time", 2.0 * T),
        (".npz", "time", 2.0 * T),
        (".mat", "time", 2.0 * T),
        (".mat", "Tinterval", 0.1),
    ],
)
def test_a_second_time_that_contradicts_is_remarked_on(
    tmp_path: Path, suffix: str, name: str, other: Any
) -> None:
    found = understood(written(tmp_path, suffix, other, name))
    assert sum("counts time, too" in text for text in found.warnings) == 1
    assert "11.95 s" in " ".join(found.warnings) and "23.9 s" in " ".join(found.warnings)
    chosen = understood(tmp_path / f"a{suffix}", 'time = "t"\n')
    assert not any("counts time" in text for text in chosen.warnings)
    agree = understood(written(tmp_path, suffix, other / 2.0, name))
    assert not any("counts time" in text for text in agree.warnings)
    np.testing.assert_allclose(agree["1"].t, T)


@pytest.mark.parametrize(
    ("other", "n"),
    [
        (1.02 * T, 1),
        (1.005 * T, 0),  # two clocks of one record
        (T + 1.2 * (T == T[-1]), 1),
        (np.tile(np.arange(20) * 50.0, 12), 0),  # milliseconds beside seconds, which begin again
    ],
    ids=["longer", "as long", "late at the end", "begins again"],
)
def test_how_far_two_clocks_may_disagree(tmp_path: Path, other: Any, n: int) -> None:
    found = understood(written(tmp_path, ".csv", other, "elapsed_s"))
    assert sum("counts time, too" in text for text in found.warnings) == n


@pytest.mark.parametrize(("late", "n"), [(0.9, 0), (1.6, 1)])
def test_clocks_may_differ_by_one_step_of_theirs(tmp_path: Path, late: float, n: int) -> None:
    t = np.arange(40.0)  # one step is more than a hundredth of the record
    other = t + late * (t == t[-1])
    pd.DataFrame({"t": t, "y": Y[::6], "elapsed_s": other}).to_csv(tmp_path / "a.csv", index=False)
    found = understood(tmp_path / "a.csv")
    assert sum("counts time, too" in text for text in found.warnings) == n


@pytest.mark.parametrize(
    ("first", "second", "days"),
    [
        (45356.5, 1 / 86400, True),
        (739316.5, 1 / 86400, True),
        (45356.5, 1.0, False),  # the seconds of a clock that began half a day ago
        (19000.5, 1 / 86400, False),
    ],
)
def test_days_without_a_word_are_not_taken_for_seconds_in_silence(
    tmp_path: Path, first: float, second: float, days: bool
) -> None:
    file = tmp_path / "a.csv"
    file.write_text(
        "time,V\n"
        + "".join(f"{first + a * second:.10f},{b:.4f}\n" for a, b in zip(T, Y, strict=True))
    )
    assert any("look like days" in text for text in understood(file).warnings) == days
    if days and first < 1e5:  # the advice helps
        file.write_text(file.read_text().replace("time,", "datetime,"))
        assert any("was read in days" in text for text in understood(file).warnings)


@pytest.mark.parametrize(
    ("codes", "n", "place"),
    [
        ({60: -9999.0}, "1 sample is -9999", "at row 62"),
        ({0: -999.99, 9: -999.99}, "2 samples are -999.99", "the first at row 2"),
        ({239: 65535.0}, "1 sample is 65535", "at row 241"),
    ],
)
def test_codes_for_no_measurement_are_left_out(
    tmp_path: Path, codes: dict[int, float], n: str, place: str
) -> None:
    y = Y.copy()
    y[list(codes)] = list(codes.values())
    stream = io.StringIO()
    pd.DataFrame({"t": T, "y": y}).to_csv(stream, index=False)
    (tmp_path / "a.csv").write_text(stream.getvalue())
    found = understood(tmp_path / "a.csv")
    assert any(f"{n}, a code for no measurement, {place}" in text for text in found.warnings)
    assert not any("not a number" in text for text in found.warnings)
    (e,) = found
    assert list(np.flatnonzero(~e.used)) == list(codes) and np.abs(e.y).max() <= 1.0


def test_one_sample_apart_is_remarked_on_and_kept(tmp_path: Path) -> None:
    y = Y.copy()
    y[60] = 12.3
    pd.DataFrame({"t": T, "y": y}).to_csv(tmp_path / "a.csv", index=False)
    found = understood(tmp_path / "a.csv")
    assert any("row 62: one sample, 12.3, lies far" in text for text in found.warnings)
    assert found["1"].used.all()
