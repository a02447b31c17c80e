"""Type of every figure at the width at which it is printed; nothing cut off at an edge."""

import importlib
import io
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from bayes_sensor import figures
from bayes_sensor.blind_check import make_card
from bayes_sensor.coating import Coating, solve
from bayes_sensor.coating.readout import matched_readout
from bayes_sensor.figures.plot_blind_check import opened_seal, score_card
from bayes_sensor.figures.style import SMALLEST, settle
from tests.figures.test_figures import MAKERS
from tests.figures.test_plot_tau import coverage_rows, hard, help_rows
from tests.fleet.test_fleet import row as fleet_row

ROOT = Path(__file__).resolve().parents[2]
PAPER = ROOT / "paper"
TEMPLATE = ROOT / "bayes_sensor" / "templates" / "report.typ"
A4 = 210.0  # mm
INCH = 25.4  # mm
ROUNDING = 0.99  # figures may be a hair wider than the text


def text_width(typst: Path) -> float:
    """Inches between the margins of a typst document on A4."""
    margin = re.search(r"margin: \(x: (\d+)mm", typst.read_text(encoding="utf-8"))
    assert margin is not None
    return (A4 - 2.0 * float(margin[1])) / INCH


def drawn_sizes(figure: Figure) -> dict[float, str]:
    """Points of every text of the drawing as saved, with an example; raised digits left out."""
    stream = io.StringIO()
    with figures.style():
        settle(figure)
        figure.savefig(stream, format="svg")
    found = {}
    for style, words in re.findall(r'<text style="([^"]*)"[^>]*>([^<]*)<', stream.getvalue()):
        size = re.search(r"(?:font-size|font): (?:[a-z0-9]+ )*?([\d.]+)px", style)
        assert size is not None, style
        found[float(size[1])] = words
    return found


def check(figure: Figure) -> None:
    width, height = figure.get_size_inches()
    printed = min(text_width(PAPER / "manuscript.typ"), text_width(TEMPLATE))
    scale = min(1.0, printed / width)
    sizes = drawn_sizes(figure)
    assert sizes, "no text is drawn"
    smallest = min(sizes)
    assert smallest * scale >= ROUNDING * SMALLEST, (smallest * scale, sizes[smallest])
    with figures.style():
        box = figure.get_tightbbox()  # type: ignore[call-arg]  # renderer: the figure's own
    # inches: a hair more than the pixel to which text is measured
    cut = 0.03
    assert box.x0 > -cut and box.y0 > -cut, box
    assert box.x1 < width + cut and box.y1 < height + cut, box


def seal() -> Figure:
    which = [{"effect": f"an_effect_{k}", "probability": 0.3 / (k + 1)} for k in range(9)]
    shrink = {"tau_before_s": 0.05, "tau_after_s": 0.04, "tau_after_lo_s": 0.03,
              "tau_after_hi_s": 0.05}  # fmt: skip
    row = {"listed_as": "an_effect_0", "closed": 0.9, "closed_lo": 0.8, "closed_hi": 1.0,
           "closed_oracle": 0.95, "tau_true_s": 0.045}  # fmt: skip
    return opened_seal({"which": which, "shrink": shrink}, row)


def many_chains() -> tuple[list[str], np.ndarray]:
    """Chains with as wide tick labels as any."""
    names = ["tau_s", "tau_v_s", "V_mL", "phi", "sigma0_V", "sigma1_V"]
    centre = np.array([0.0242, 0.8577, 58.231, 0.79962, 0.045061, 0.072312])
    spread = np.array([2e-2, 6e-3, 0.55, 6e-4, 8e-5, 1.6e-4])
    rng = np.random.default_rng(3)
    return names, centre + spread * rng.standard_normal((4, 800, 6))


MORE: dict[str, Callable[[], Figure]] = {
    "tau_hard": lambda: figures.tau_hard(hard()),
    "what_would_help": lambda: figures.what_would_help(help_rows()),
    "coverage": lambda: figures.coverage(coverage_rows()),
    "corner of six": lambda: figures.corner(*many_chains()),
    "traces of six": lambda: figures.traces_and_ranks(*many_chains()),
    "forest": lambda: figures.forest([fleet_row(f"a long name {k}", 20 + k, 4) for k in range(9)]),
    "where of many": lambda: figures.gap_where(
        [{"experiment": f"{k}", "phase": "rise", "excess_rms_V": 1e-3, "share": 0.1,
          "p_value": 0.01} for k in range(30)]
    ),
    "score_card": lambda: score_card(make_card([])),
    "opened_seal": seal,
    "coating": lambda: figures.diffusion_figure(
        solve(tolerance=2e-3), solve(Coating(d_zif8=2.6e-11), tolerance=2e-3)
    ),
    "spectra": lambda: figures.spectra_figure(matched_readout()),
}  # fmt: skip


@pytest.mark.parametrize("name", [*MAKERS, *MORE])
def test_type_is_readable_in_print_and_whole(name: str) -> None:
    check(MAKERS[name][0]() if name in MAKERS else MORE[name]())


def test_small_or_cut_type_is_seen() -> None:
    with figures.style():
        figure = Figure(figsize=(7.2, 2.0), layout="none")
        figure.text(0.5, 0.5, "small", fontsize=7)
    with pytest.raises(AssertionError, match="small"):
        check(figure)
    with figures.style():
        figure = Figure(figsize=(6.0, 2.0), layout="none")
        figure.text(-0.1, 0.5, "cut", fontsize=9)
    with pytest.raises(AssertionError):
        check(figure)


@pytest.fixture
def studies(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Figure]]:
    """What the studies draw from their tables, instead of being saved; by name."""
    import matplotlib.pyplot as plt

    monkeypatch.syspath_prepend(str(PAPER / "studies"))
    for name in [n for n in sys.modules if n == "drawing" or n.startswith("study_")]:
        monkeypatch.delitem(sys.modules, name)  # another test's, which save for good
    before = set(sys.modules)
    kept: dict[str, Figure] = {}
    with mpl.rc_context():
        drawing = importlib.import_module("drawing")
        monkeypatch.setattr(drawing, "save", lambda figure, name: kept.update({name: figure}))
        yield kept
        plt.close("all")
    for name in set(sys.modules) - before:
        if name == "drawing" or name.startswith("study_"):
            del sys.modules[name]


def read(name: str, **options: Any) -> pd.DataFrame:
    return pd.read_csv(PAPER / "tables" / f"{name}.csv", **options)


def study(name: str) -> ModuleType:
    return importlib.import_module(f"study_{name}")


@pytest.mark.tables
def test_type_of_the_studies_figures(studies: dict[str, Figure]) -> None:
    sbc = study("sbc")
    ranks = read("sbc_ranks")
    sbc.draw(sbc.Ranks(tuple(ranks.columns), ranks.to_numpy(), sbc.N_RANKS))
    study("coverage").draw_parameters(read("coverage_posterior"))
    study("coverage").draw_tau(read("coverage_tau"))
    words = {"keep_default_na": False}
    numbers = {"converters": {key: float for key in ("value",)}}
    power = read("gap_power", **words, **numbers)
    for key in ("low", "high"):
        power[key] = pd.to_numeric(power[key])
    study("gap").draw_power(power, read("gap_cases"))
    study("gap").draw_isolability(read("gap_isolability", **words))
    study("coating").draw(read("coating_inverse"))
    assert len(studies) == 6
    for name, figure in studies.items():
        with mpl.rc_context({"svg.fonttype": "none"}):
            stream = io.StringIO()
            figure.savefig(stream, format="svg")
        # formulas are groups whose subscripts are smaller by custom: their first size counts
        sizes = [
            float(size)
            for size in re.findall(
                r'<text style="(?:[^"]*?)(?:font-size|font): (?:[a-z0-9]+ )*?([\d.]+)px',
                stream.getvalue(),
            )
        ]
        width = figure.get_size_inches()[0]
        scale = min(1.0, text_width(PAPER / "manuscript.typ") / width)
        assert sizes and min(sizes) * scale >= ROUNDING * SMALLEST, (name, min(sizes))


@pytest.mark.prose
def test_the_manuscript_shows_its_figures_at_their_own_size() -> None:
    text = (PAPER / "manuscript.typ").read_text(encoding="utf-8")
    assert not re.search(r"image\([^)]*width", text)
    for path in sorted((PAPER / "figures").glob("*.svg")):
        made = re.search(r'<svg[^>]* width="([\d.]+)pt"', path.read_text(encoding="utf-8"))
        assert made is not None
        assert ROUNDING * float(made[1]) / 72 <= text_width(PAPER / "manuscript.typ"), path.name
