"""The figure of a restored record: labelled, the same bytes each time, gaps and no resolution."""

import numpy as np

import bayes_sensor as bs
from bayes_sensor import figures


def record(n: int, gap: bool) -> tuple[np.ndarray, np.ndarray]:
    t = 60.0 * np.arange(n)
    y = np.sin(t / 3000.0) + 0.02 * np.random.default_rng(1).standard_normal(n)
    if gap:
        y[n // 2 : n // 2 + 20] = np.nan
    return t, y


def test_record_input_band_resolution_and_gap_are_shown() -> None:
    found = bs.restore("20 +- 1 min", record(300, gap=True), signal_unit="ppm")
    drawing = figures.svg(figures.restored(found))
    assert drawing == figures.svg(figures.restored(found))
    assert found.resolution_s is not None
    for words in ("record (ppm)", "restored input (ppm)", "time (h)", "95 %", "68 %", "no samples",
                  f"resolution {found.resolution_s:.3g} s"):  # fmt: skip
        assert words in drawing, words


def test_a_long_record_is_drawn_in_stretches_that_keep_its_extremes() -> None:
    t, y = record(20_000, gap=False)
    y[12_345] = 9.0
    found = bs.restore("20 +- 1 min", (t, y))
    figure = figures.restored(found)
    upper, lower = figure.axes
    assert upper.get_ylim()[1] > 9.0
    assert all(len(line.get_xdata()) <= 4001 for line in lower.lines)
    assert len(figures.svg(figure)) < 2_000_000
    assert "no samples" not in figures.svg(figure)
