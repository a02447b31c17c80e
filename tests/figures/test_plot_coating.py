"""Figures of coating and readout: units, marks, grey, the same bytes."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from bayes_sensor import figures
from bayes_sensor.coating import Coating, Response, solve
from bayes_sensor.coating.readout import Cladding, Readout, Ring, linear_range, matched_readout
from bayes_sensor.figures.plot_coating import UPTAKE_MAP, diffusion_figure, spectra_figure


@pytest.fixture(scope="module")
def pair() -> tuple[Response, Response]:
    return solve(tolerance=2e-3), solve(Coating(d_zif8=2.6e-11), tolerance=2e-3)


def all_axes(figure: Figure):
    return [axes for axes in figure.axes if axes.get_visible()]


def markers(figure: Figure) -> set[tuple[float, float]]:
    """Rounded coordinates of every line of a single point."""
    lines = [line for axes in all_axes(figure) for line in axes.get_lines()]
    points = [line.get_xydata()[0] for line in lines if len(line.get_xydata()) == 1]
    return {(round(float(x), 2), round(float(y), 2)) for x, y in points}


def test_fig_9_marks_the_probe_and_the_times(pair):
    figure = diffusion_figure(*pair)
    maps = [axes for axes in all_axes(figure) if axes.get_title(loc="left").endswith("ms")]
    assert len(maps) == 4
    assert [float(a.get_title(loc="left").split()[0]) for a in maps] == pytest.approx(
        1e3 * pair[0].snapshot_times, rel=5e-3
    )
    found = markers(figure)
    assert (10.0, 0.22) in found
    for response in pair:
        assert (round(1e3 * response.tau63, 2), 63.21) in found


def test_every_axis_has_a_unit(pair):
    for figure in (diffusion_figure(*pair), spectra_figure(matched_readout())):
        labels = [t for a in all_axes(figure) for t in (a.get_xlabel(), a.get_ylabel()) if t]
        assert len(labels) >= 4
        assert all(re.search(r"\((µm|ms|%|nm|V)\)$", text) for text in labels), labels


def test_one_coating_alone_and_one_without_a_side(pair):
    one = diffusion_figure(pair[0])
    assert len(all_axes(one)) == len(all_axes(diffusion_figure(*pair)))
    endless = solve(Coating(outer_radius=math.inf), tolerance=5e-3, snapshot_times=[0.01] * 6)
    figure = diffusion_figure(endless)
    assert (0.0, 0.22) in markers(figure)
    assert figures.png(figure).startswith(b"\x89PNG")
    bare = replace(pair[0], snapshot_times=np.empty(0), snapshots=np.empty((0, 1, 1)))
    with pytest.raises(ValueError, match="no snapshots"):
        diffusion_figure(bare)


def test_the_map_darkens_in_grey():
    grey = np.array([UPTAKE_MAP(x)[:3] for x in np.linspace(0, 1, 50)]) @ [0.299, 0.587, 0.114]
    assert (np.diff(grey) < 0).all()


def test_fig_3_marks_the_laser_and_the_linear_range():
    readout = matched_readout()
    concentrations = [0.0, 0.1]
    figure = spectra_figure(readout, concentrations)
    found = markers(figure)
    for c in concentrations:
        volts = round(float(readout.voltage(c)), 2)
        assert (1574.4, volts) in found
        assert (round(100 * c, 2), volts) in found
    shaded = all_axes(figure)[1].patches[0].get_extents()
    ends = all_axes(figure)[1].transData.inverted().transform(shaded)[:, 0]
    linear = linear_range(readout)
    np.testing.assert_allclose(ends, [100 * linear.low, 100 * linear.high], rtol=1e-6)


def test_fig_3_of_a_laser_past_the_steepest_point():
    past = Readout(Ring(), Cladding(), wavelength=1574.3e-9)
    figure = spectra_figure(past, [0.05])
    assert not all_axes(figure)[1].patches
    for wrong in ([], [-0.1], [math.nan]):
        with pytest.raises(ValueError, match="at least one concentration"):
            spectra_figure(past, wrong)


def test_the_same_figure_is_the_same_bytes(pair):
    assert figures.svg(diffusion_figure(*pair)) == figures.svg(diffusion_figure(*pair))
    a, b = (figures.svg(spectra_figure(matched_readout())) for _ in range(2))
    assert a == b
