"""One record from a file: gaps of any length, irregular times, units, MATLAB's days."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.io.record_file import read_record


def csv(path: Path, t: np.ndarray, y: np.ndarray, header: str = "time_s,level_mV") -> Path:
    rows = [
        f"{a:.6g},{b:.9g}" if np.isfinite(b) else f"{a:.6g}," for a, b in zip(t, y, strict=True)
    ]
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_a_short_gap_is_part_of_the_grid_and_a_long_one_is_a_step(tmp_path: Path) -> None:
    t = np.arange(200.0)
    y = np.sin(t / 9.0)
    kept = np.r_[0:100, 150:200]
    short = read_record(csv(tmp_path / "a.csv", t[kept], y[kept]))
    np.testing.assert_allclose(short.t, t)
    assert np.isnan(short.y[100:150]).all() and np.isfinite(short.y).sum() == 150
    assert "50 of 200 samples are missing" in short.notes[-1]
    late = t.copy()
    late[100:] += 5000.0
    long = read_record(csv(tmp_path / "b.csv", late, y))
    np.testing.assert_allclose(long.t, late)
    assert np.isfinite(long.y).all()


def test_irregular_times_and_units(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.5, 3.0, 100)).round(3)
    y = rng.standard_normal(100)
    path = csv(tmp_path / "a.csv", t, y)
    found = read_record(path)
    np.testing.assert_allclose(found.t, t)
    assert found.unit == "mV"
    np.testing.assert_allclose(read_record(path, signal_unit="V").y, 1e-3 * found.y)
    with pytest.raises(CampaignError, match="another quantity"):
        read_record(path, signal_unit="ppm")
    bare = tmp_path / "bare.csv"
    bare.write_text("level_mV\n" + "\n".join(f"{value:.6g}" for value in y) + "\n")
    no_times = read_record(bare, interval="2 s")
    np.testing.assert_allclose(no_times.t, 2.0 * np.arange(100))


def test_matlab_days_are_days_and_seconds_stay_seconds(tmp_path: Path) -> None:
    t = 2.0 * np.arange(300)
    y = np.sin(t / 50.0)
    savemat(tmp_path / "days.mat", {"time": 736259.45 + t / 86400.0, "slow": y})
    days = read_record(tmp_path / "days.mat", signal="slow")
    np.testing.assert_allclose(np.diff(days.t), 2.0, rtol=1e-3)  # datenum resolves 10 us
    assert days.t[0] == 0.0 and "MATLAB's days" in days.notes[0]
    (tmp_path / "campaign.toml").write_text(
        '[rig]\nstages = ["sensor"]\n[[experiment]]\nname = "1"\nfile = "days.mat"\n'
        'commanded_on = "2015-10-22 10:50:00"\n'
    )
    found = read_campaign(tmp_path / "campaign.toml")  # as in a campaign
    assert found["1"].commanded_on == 120.0 and "MATLAB's days" in found.warnings[0]
    savemat(tmp_path / "seconds.mat", {"time": t, "slow": y})
    np.testing.assert_allclose(read_record(tmp_path / "seconds.mat", signal="slow").t, t)


def test_what_is_no_record_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="no such file"):
        read_record(tmp_path / "gone.csv")
    with pytest.raises(CampaignError, match="ending in"):
        read_record(tmp_path / "a.docx")
