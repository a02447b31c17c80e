"""One style for every figure, and the figure as SVG, PNG or PDF.

Colours are from Okabe and Ito's palette, chosen so that lines also differ in grey.  Important lines
also differ in line style or marker.  Figures are made without pyplot's global state, and the same
records give the same bytes.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager, get_font
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

INK = "#1b1b1b"
PALE = "#d4d4d4"
MIDDLE = "#7a7a7a"
DATA = "#8fb4d3"
MODEL = "#a01c1c"
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"
REGIONS = ("#dbe8f2", "#a9cae2", "#6fa6cd")
GROUND = "#ffffff"
COLOURS = (GROUND, INK, PALE, MIDDLE, DATA, MODEL, BLUE, ORANGE, GREEN, *REGIONS)
"""every colour in use; the page has a counterpart of each for a dark background"""
WIDTH = 6.4
"""inches, as wide as the text of the manuscript: a point in a figure is a point in print"""
SMALLEST = 7
"""points; smaller print is hard to read"""
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": MIDDLE,
    "axes.facecolor": "none",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titley": 1.0,  # given, it need not be found from the boxes of all ticks
    "figure.facecolor": "none",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.5,
    "grid.color": PALE,
    "grid.linewidth": 0.5,
    "legend.edgecolor": PALE,
    "legend.facecolor": "none",
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.facecolor": "none",
    "svg.fonttype": "none",
    "svg.hashsalt": "bayes_sensor",
    "text.color": INK,
    "text.hinting": "none",  # hinted letters are narrower than those of a vector drawing
    "text.parse_math": False,  # a name may hold dollar signs
    "xtick.color": MIDDLE,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 7.5,
    "ytick.color": MIDDLE,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 7.5,
}

SHARED_LABELS = {
    "tau_s": ("sensor τ", "ms", 1e3),
    "tau_v_s": ("valve τᵥ", "ms", 1e3),
    "lag_fast_s": ("shorter lag", "s", 1.0),
    "lag_between_s": ("middle lag", "s", 1.0),
    "lag_slow_s": ("longer lag", "s", 1.0),
    "V_mL": ("volume V", "mL", 1.0),
}
"""flat name to words, unit shown and the factor to it; lags by size are those that cannot be
assigned"""


def shared_labels(names: Iterable[str]) -> dict[str, tuple[str, str, float]]:
    """Words, unit shown and factor of the shared parameters among ``names``: those of
    :data:`SHARED_LABELS`, then lags and volumes of other stages and sensors.

    >>> shared_labels(["V_mL", "tau_s[A]", "tau_filter_s", "phi"])["tau_filter_s"]
    ('filter τ', 's', 1.0)
    """
    names = list(dict.fromkeys(names))
    found = {name: words for name, words in SHARED_LABELS.items() if name in names}
    for name in names:
        words = _stage_label(name)
        if name not in found and words is not None:
            found[name] = words
    return found


def _stage_label(name: str) -> tuple[str, str, float] | None:
    """The same of a stage of another rig or of one of several sensors; None for anything else."""
    kind, bracket, rest = name.partition("[")
    if kind == "tau_s" and bracket:
        return f"sensor {rest.removesuffix(']')} τ", "s", 1.0
    if bracket:
        return None
    if kind.startswith("lag_") and kind.endswith("_s"):
        return kind.removesuffix("_s").replace("_", " "), "s", 1.0
    if kind.startswith("tau_") and kind.endswith("_s"):
        return f"{kind[4:-2].replace('_', ' ')} τ", "s", 1.0
    if kind.startswith("V_") and kind.endswith("_mL"):
        return f"{kind[2:-3].replace('_', ' ')} V", "mL", 1.0
    return None


def told_apart(names: Iterable[str]) -> list[str]:
    """``names`` of a posterior, shared ones first, without tau and tau_v if they cannot be
    assigned.

    >>> told_apart(["tau_s", "tau_v_s", "V_mL", "lag_fast_s", "lag_slow_s", "phi"])
    ['lag_fast_s', 'lag_slow_s', 'V_mL', 'phi']
    """
    names = list(names)
    unknown = set()
    if any(name.startswith("lag_") for name in names):
        unknown = {"tau_s", "tau_v_s"}
    if "lag_between_s" in names:  # at one flow that may be V/Q
        unknown.add("V_mL")
    shared = list(shared_labels(names))
    rest = [name for name in names if name not in shared]
    return [name for name in [*shared, *rest] if name not in unknown]


def labels_of_bounds(bounds: Mapping[str, Any]) -> dict[str, tuple[str, str, float]]:
    """:func:`shared_labels` of the content of ``bounds.json``."""
    rows = [row for entry in bounds["methods"].values() for row in entry["parameters"].items()]
    if not any(name.startswith("lag_") for name, _ in rows):
        return shared_labels(name for name, _ in rows)
    return shared_labels(name for name, row in rows if row)


_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""characters that XML does not know, but a name may hold"""


def style() -> Any:
    """The context in which every figure is made and saved."""
    return mpl.rc_context(STYLE)  # type: ignore[arg-type]  # keys are checked when set


@contextmanager
def _drawing() -> Iterator[None]:
    """The style; a letter that is not in the font is drawn as a box, without a warning."""
    with style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        yield


class Drawing(Figure):
    """A figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        return png(self)


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """A figure whose layout is solved: for pictures that are drawn once, on demand."""
    return Drawing(figsize=(width, height), layout="constrained")


def content_of(record: Any) -> Any:
    """The content of a saved result: of a record that knows it, or the content itself.

    >>> content_of({"rms_V": 0.1})
    {'rms_V': 0.1}
    """
    return record.to_json() if hasattr(record, "to_json") else record


def no_data(sentence: str, axes: Axes | None = None) -> Figure | Axes:
    """A panel that says why there is nothing to draw."""
    with style():
        figure = None if axes is not None else new_figure(1.2, 4.6)
        panel = axes if figure is None else figure.subplots()
        assert panel is not None
        panel.annotate(
            sentence, (0.5, 0.5), xycoords="axes fraction", ha="center", va="center", wrap=True
        )
        panel.set_axis_off()
    return panel if figure is None else figure


def panels(
    height: float,
    rows: int = 1,
    columns: int = 1,
    width: float = WIDTH,
    *,
    left: float = 0.7,
    right: float = 0.12,
    top: float = 0.3,
    bottom: float = 0.45,
    across: float = 0.7,
    down: float = 0.75,
    **options: Any,
) -> tuple[Figure, Any]:
    """A figure with fixed margins and gaps, all in inches, and its axes (rows, columns).

    No layout is solved: a solver draws each figure once more to measure its texts.  ``options`` are
    those of :meth:`Figure.subplots`.
    """
    figure = Drawing(figsize=(width, height))
    inside = width - left - right, height - top - bottom
    each = [max(s - gap * (n - 1), 0.2) / n
            for s, gap, n in zip(inside, (across, down), (columns, rows), strict=True)]  # fmt: skip
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    figure.subplots_adjust(
        left=left / width, right=1.0 - right / width, top=1.0 - top / height,
        bottom=bottom / height, wspace=across / each[0], hspace=down / each[1],
    )  # fmt: skip
    return figure, grid


def beside(names: Iterable[str], size: float = 7.5, more: float = 0.16) -> float:
    """Inches that ``names`` take to the left of an axis, in letters of ``size`` points."""
    font = get_font(fontManager.findfont("DejaVu Sans"))
    font.set_size(size, 72)
    widths = []
    for name in names:
        with warnings.catch_warnings():  # a letter that is not in the font is drawn as a box
            warnings.simplefilter("ignore", UserWarning)
            font.set_text(name, 0.0)
        widths.append(font.get_width_height()[0] / 64.0)
    return max(widths, default=0.0) / 72.0 + more


def settle(figure: Figure) -> None:
    """Lay out once and round the places of the axes, and of the figures inside the figure.

    The layout's solver is exact only to rounding, which would otherwise change the bytes.
    """
    engine = figure.get_layout_engine()
    if engine is None or isinstance(engine, PlaceHolderLayoutEngine):
        return  # placed by hand, or settled before
    engine.execute(figure)
    figure.set_layout_engine("none")
    inside = list(figure.subfigs)
    for part in inside:  # grows by what is inside of each
        part.bbox_relative.set_points(np.round(part.bbox_relative.get_points(), 5))
        inside += part.subfigs
    for axes in figure.axes:
        left, bottom, width, height = (round(float(v), 5) for v in axes.get_position().bounds)
        axes.set_position((left, bottom, width, height))


def svg(figure: Figure) -> str:
    """The figure as the text of an SVG element, without date or XML header."""
    stream = io.StringIO()
    with _drawing():
        settle(figure)
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = _NO_XML.sub("\ufffd", stream.getvalue())
    return text[text.index("<svg") :]


def png(figure: Figure, dpi: int = 160) -> bytes:
    """The figure as a PNG on white."""
    stream = io.BytesIO()
    with _drawing():
        settle(figure)
        figure.savefig(
            stream, format="png", dpi=dpi, facecolor="white", metadata={"Software": None}
        )
    return stream.getvalue()


def pdf(figure: Figure) -> bytes:
    """The figure as a PDF page, without a date."""
    stream = io.BytesIO()
    with _drawing():
        settle(figure)
        figure.savefig(stream, format="pdf", facecolor="white", metadata={"CreationDate": None})
    return stream.getvalue()


def logarithmic(axes: Axes, which: str) -> None:
    """A logarithmic axis with plain numbers (10 rather than a power in mathematical type).

    It stays linear where nothing positive is drawn.
    """
    axis = axes.xaxis if which == "x" else axes.yaxis
    if not axis.get_data_interval()[1] > 0.0:
        return
    axes.set(**{f"{which}scale": "log"})
    low, high = axis.get_view_interval()
    if high < 30 * low:
        axis.set_major_locator(LogLocator(subs=(1, 2, 3, 5, 7) if high < 5 * low else (1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axis.set_minor_locator(NullLocator())  # ticks are what takes longest to draw


def show_zero(axes: Axes, low: float, high: float) -> None:
    """Start the axis at zero, unless all values between ``low`` and ``high`` lie far from it."""
    if not low > 0.5 * high:
        axes.set_xlim(left=0.0)


def plain(value: float) -> str:
    """A number as a reader writes it: small ones as powers of ten.

    >>> plain(0.01), plain(1e-6), plain(2e-11), plain(2000.0)
    ('0.01', '10⁻⁶', '2 × 10⁻¹¹', '2000')
    """
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:g}"
    mantissa, exponent = f"{value:e}".split("e")
    front = f"{float(mantissa):g}"
    return ("" if front == "1" else f"{front} × ") + "10" + raised(int(exponent))


def raised(exponent: int) -> str:
    """An exponent in small raised digits."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def thousands(count: float) -> str:
    """A count in groups of three digits, which no line breaks.

    >>> thousands(840000) == "840\\u00a0000", thousands(4500)
    (True, '4500')
    """
    return f"{count:,.0f}".replace(",", "\u00a0") if count > 9999 else f"{count:.0f}"


def volts(unit: str, size: float) -> tuple[str, float]:
    """Unit and factor that make values near ``size`` readable."""
    return ("mV", 1e3) if unit == "V" and size < 0.5 else (unit, 1.0)


def shortened(text: str, most: int = 18) -> str:
    """A text of at most ``most`` characters; the tables have all of it.

    >>> shortened("the same gas, once more", 9)
    'the same…'
    """
    return text if len(text) <= most else text[: most - 1] + "…"


def parameter_words(name: str, unit: str = "V") -> tuple[str, str, float]:
    """Symbol, unit shown and factor to it, of a flat parameter name.

    >>> parameter_words("t0_s[4]")
    ('t₀[4]', 's', 1.0)
    >>> parameter_words("drift_V_per_s")
    ('drift', 'V/s', 1.0)
    """
    shared = shared_labels([name])
    if shared:
        return shared[name]
    kind, bracket, rest = name.partition("[")
    symbols = {
        "phi": "φ", "sigma0_V": "σ₀", "sigma1_V": "σ₁",
        "y0_V": "y₀", "beta_V": "β", "t0_s": "t₀", "tf_s": "t_f",
    }  # fmt: skip
    if kind not in symbols:  # a parameter of an effect
        from bayes_sensor.rig.layout import UNITS, unit_of

        own = unit_of(kind, unit)
        words = kind.split("_")
        while own != "1" and (words[-1] in UNITS or words[-1] == "per") and len(words) > 1:
            words.pop()
        return " ".join(words) + bracket + rest, "" if own == "1" else own, 1.0
    shown, factor = ("", 1.0) if kind == "phi" else ("s", 1.0) if kind.endswith("_s") else (unit, 1)
    if kind.startswith("sigma") and unit == "V":
        shown, factor = "mV", 1e3
    return symbols.get(kind, kind) + bracket + rest, shown, factor


def axis_label(words: tuple[str, str, float]) -> str:
    return f"{words[0]} ({words[1]})" if words[1] else words[0]
