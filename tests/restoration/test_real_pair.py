"""A slow methane sensor beside a fast one; the folder of the measurements is in the environment."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import bayes_sensor as bs

WHERE = "BAYES_SENSOR_SLOW_AND_FAST"


@pytest.mark.skipif(not os.environ.get(WHERE), reason=f"{WHERE} is not set")
def test_the_restored_slow_sensor_follows_the_fast_one() -> None:
    path = Path(os.environ[WHERE]) / "field.mat"
    fast = loadmat(path)["fast"].ravel()
    seen = np.isfinite(fast)
    # the lag, its spread and the gain of the step record, see paper/studies/study_restoration.py
    found = bs.restore("1972 +- 237 s", path, signal="slow", signal_unit="ppm", nonnegative=True)
    raw = np.corrcoef(found.recorded[seen], fast[seen])[0, 1] ** 2
    restored = np.corrcoef(found.value[seen], fast[seen])[0, 1] ** 2
    assert raw < 0.2 and restored > 0.86
    low, high = found.quantile(0.025) / 0.737, found.quantile(0.975) / 0.737
    assert np.mean(((low < fast) & (fast < high))[seen]) > 0.82
