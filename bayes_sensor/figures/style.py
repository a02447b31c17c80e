"""One style for every figure, and the figure as SVG, PNG or PDF.

Figures are made without pyplot's global state, and the same records give the same bytes.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager, get_font
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from bayes_sensor.figures.colours import INK, MIDDLE, PALE
from bayes_sensor.figures.labels import plain

WIDTH = 6.4
"""inches, as wide as the text of the manuscript: a point in a figure is a point in print"""
SMALLEST = 7
"""points; smaller print is hard to read"""
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


SOFTWARE = "bayes-sensor"
"""that a PNG says it was drawn by"""


def png(figure: Figure, dpi: int = 160) -> bytes:
    """The figure as a PNG on white."""
    stream = io.BytesIO()
    with _drawing():
        settle(figure)
        figure.savefig(
            stream, format="png", dpi=dpi, facecolor="white", metadata={"Software": SOFTWARE}
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
