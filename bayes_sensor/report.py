"""The report: saved results in, one self-contained HTML page out.

Everything is read back from a results directory, nothing is computed again, and every text that
came from a file or a user is escaped.  The page needs no network; without scripts it loses only
sorting and copying of tables.
"""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from math import floor, log10
from pathlib import Path
from typing import Any

from bayes_sensor import __version__, figures
from bayes_sensor.campaign import CampaignError
from bayes_sensor.results import Results, Trace, load_traces

MOST_OVERLAYS = 5 << 20
"""bytes of vector overlays in a page; beyond, they are embedded as pixels"""
MOST_PIXELS = 6 << 20
"""bytes of overlays as pixels; beyond, they are only saved beside the page"""
PUBLISHED_3SD = {"tau_s": 0.0056049, "tau_v_s": 0.0086029, "V_mL": 0.6817}
"""the paper's Table III"""
METHOD_NOTE = {
    "crlb_iid": "the classical bound, with its derivatives taken correctly",
    "crlb_iid_one_percent_step": "the published recipe",
}

# --------------------------------------------------------------------------- numbers as text


def number(value: float | None, digits: int = 3) -> str:
    """A number with ``digits`` significant digits, never in powers of ten unless it must be.

    >>> number(0.0481234), number(None), number(1234567.0), number(0.0)
    ('0.0481', '–', '1234567', '0')
    """
    if value is None:
        return "–"
    if value == 0:
        return "0"
    exponent = floor(log10(abs(value)))
    if exponent < -4 or exponent > 9:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def with_spread(value: float | None, spread: float | None) -> str:
    """A number rounded to two digits of its spread.

    >>> with_spread(58.1747, 0.5337)
    '58.17'
    """
    if value is None:
        return "–"
    if not spread:
        return number(value, 4)
    decimals = max(0, 1 - floor(log10(spread)))
    return f"{value:.{min(decimals, 9)}f}"


def p_words(p: float | None) -> str:
    """A p-value in words that do not pretend.

    >>> p_words(1e-30), p_words(0.0312)
    ('below 0.001', '0.031')
    """
    if p is None:
        return "–"
    return "below 0.001" if p < 0.001 else f"{p:.2g}"


def list_words(items: Sequence[str], most: int = 6) -> str:
    """Items joined as in a sentence.

    >>> list_words(["a", "b", "c"])
    'a, b and c'
    """
    items = list(items)
    if len(items) > most:
        items = [*items[: most - 1], f"{len(items) - most + 1} more"]
    return " and ".join(filter(None, [", ".join(items[:-1]), *items[-1:]]))


# --------------------------------------------------------------------------- the page's parts


@dataclass
class Table:
    """A table that can be sorted and copied."""

    key: str
    caption: str
    columns: list[str]
    rows: list[list[Any]]
    """texts, or numbers, which are rounded when shown and copied in full"""
    digits: int = 4
    marked: list[int] = field(default_factory=list)
    """rows to emphasise"""

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers."""
        return [
            any(isinstance(v, int | float) and not isinstance(v, bool) for v in column)
            for column in zip(*self.rows, strict=True)
        ] or [False] * len(self.columns)

    def cells(self, row: Sequence[Any]) -> list[dict[str, Any]]:
        """What to show and what to sort by, for one row."""
        made = []
        for value in row:
            if isinstance(value, bool) or value is None or isinstance(value, str):
                shown = {True: "yes", False: "no", None: "–"}.get(value, value)  # type: ignore[arg-type]
                made.append({"text": shown, "full": "" if value is None else shown, "num": False})
            else:
                shown = f"{value:d}" if isinstance(value, int) else number(value, self.digits)
                if isinstance(value, float) and abs(float(shown) - value) <= 1e-9 * abs(value):
                    shown = f"{value:.{self.digits + 2}g}"
                made.append({"text": shown, "full": repr(value), "num": True})
        return made


@dataclass
class Picture:
    """A figure with its caption."""

    key: str
    caption: str
    body: str
    """SVG element or img element; already safe"""


@dataclass
class Section:
    """One question and its answer."""

    key: str
    title: str
    answer: str
    """one or two sentences that answer the question"""
    paragraphs: list[str] = field(default_factory=list)
    content: list[Table | Picture] = field(default_factory=list)


def inline_svg(text: str, key: str, label: str) -> str:
    """An SVG element for the page: own ids, colours that follow the page, a label for readers.

    Raises ValueError if the drawing holds a script or a link, which figures never do.
    """
    if re.search(r"<(script|foreignObject|image|a)\b|\son\w+\s*=", text, re.IGNORECASE):
        raise ValueError(f"figure {key}: a drawing must not hold scripts, links or images")
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{key}-', text)
    text = re.sub(r'(url\(|href=")#', rf"\1#{key}-", text)
    for colour in figures.COLOURS:
        text = re.sub(
            rf"(fill|stroke|color): {colour}", rf"\1: var(--f-{colour[1:]}, {colour})", text
        )
    text = re.sub(
        r'd="[^"]*"',
        lambda m: re.sub(r"(\d+\.\d{2})\d+", r"\1", m[0]).replace("\n", ""),
        text,
    )
    text = re.sub(r'<svg\b([^>]*?) width="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'<svg\b([^>]*?) height="[^"]*"', r"<svg\1", text, count=1)
    safe = html.escape(label, quote=True)
    return text.replace("<svg", f'<svg role="img" aria-label="{safe}"', 1)


# --------------------------------------------------------------------------- what is saved


@dataclass
class Saved:
    """The content of a results directory; what was not computed is None."""

    campaign: dict[str, Any]
    fit: dict[str, Any] | None
    residuals: dict[str, Any] | None
    posterior: dict[str, Any] | None
    bounds: dict[str, Any] | None
    delays: dict[str, Any] | None
    run: dict[str, Any]
    traces: list[Trace]
    chains: tuple[list[str], Any] | None

    @property
    def unit(self) -> str:
        """The signal's unit."""
        return str(self.campaign.get("signal_unit", "V"))

    @property
    def name(self) -> str:
        """The campaign's title."""
        return str(self.campaign.get("title", "campaign"))

    @property
    def concentration(self) -> dict[str, float]:
        """Test-gas fraction by experiment."""
        return {
            e["experiment"]: e["concentration_percent"] / 100 for e in self.campaign["experiments"]
        }


def read_results(folder: str | Path) -> Saved:
    """What a results directory holds.

    Raises
    ------
    CampaignError
        If it is not a results directory, or a file in it cannot be read.
    """
    results = Results(folder)
    if not results.folder.is_dir():
        raise CampaignError(
            f"{folder}: there is no such folder; expected a results folder: "
            "run bayes-sensor analyze CAMPAIGN.toml --out FOLDER first"
        )
    if not results.has("campaign.json") or not results.has("run.json"):
        raise CampaignError(
            f"{folder}: expected a results folder with campaign.json and run.json; "
            "run bayes-sensor analyze CAMPAIGN.toml --out FOLDER first"
        )
    chains = None
    if results.has("posterior.nc"):
        from bayes_sensor.posterior import load_chains

        try:
            chains = load_chains(results.path("posterior.nc"))
        except (OSError, KeyError, ValueError) as error:
            raise CampaignError(
                f"{results.path('posterior.nc')}: expected the draws of a posterior, but they "
                f"cannot be read ({error}); run bayes-sensor posterior again"
            ) from None
    return Saved(
        campaign=results.json("campaign.json"),
        fit=results.json("fit.json"),
        residuals=results.json("residuals.json"),
        posterior=results.json("posterior.json"),
        bounds=results.json("bounds.json"),
        delays=results.json("delays.json"),
        run=results.json("run.json"),
        traces=load_traces(results.path("traces.npz")) if results.has("traces.npz") else [],
        chains=chains,
    )


# --------------------------------------------------------------------------- headline


@dataclass(frozen=True)
class Headline:
    """tau in one sentence and the naive bound beside it, in ms."""

    tau: str
    """``24.3 ms, 95 % interval [1.1, 60.5] ms (posterior, AR(1) noise)``"""
    naive: str
    """``± 46 ms``, or empty"""
    is_limit: bool
    """whether tau is only bounded from above"""
    limit: str = ""

    def __str__(self) -> str:
        text = f"tau = {self.tau}"
        return f"{text}; {self.naive}" if self.naive else text


def headline(
    posterior: Mapping[str, Any] | None, bounds: Mapping[str, Any] | None, settings: Any = None
) -> Headline | None:
    """The one sentence that the work is about; None where nothing was estimated."""
    naive = _naive_words(bounds)
    if posterior is not None:
        row = posterior["parameters"]["tau_s"]
        lo, mid, hi = (1e3 * row[key] for key in ("q2.5", "q50", "q97.5"))
        autocorrelation = ((settings or {}).get("noise") or {}).get("autocorrelation", "ar1")
        noise = "AR(1) noise" if autocorrelation == "ar1" else "white noise"
        if not posterior.get("converged", True):
            noise += "; NOT CONVERGED, do not quote"
        text = (
            f"{with_spread(mid, hi - lo)} ms, 95 % interval [{with_spread(lo, hi - lo)}, "
            f"{with_spread(hi, hi - lo)}] ms (posterior, {noise})"
        )
        half_normal = next(
            (r for r in posterior.get("tau_under_priors", []) if r["prior"] == "half_normal"), None
        )
        is_limit = lo < 0.15 * mid
        limit = ""
        if is_limit and half_normal:
            limit = f"{with_spread(1e3 * half_normal['upper95_s'], hi - lo)} ms"
        return Headline(text, naive, is_limit, limit)
    if bounds is not None:
        method = next(
            (m for m in ("profile", "sandwich", "crlb_ar1") if m in bounds["methods"]), None
        )
        if method and bounds["methods"][method]["parameters"].get("tau_s"):
            row = bounds["methods"][method]["parameters"]["tau_s"]
            lo, mid, hi = (_ms(row[key]) for key in ("lo95", "estimate", "hi95"))
            text = f"{number(mid)} ms, 95 % interval [{number(lo)}, {number(hi)}] ms ({method})"
            return Headline(text, naive, lo is not None and lo <= 0)
    return None


def _ms(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _naive_words(bounds: Mapping[str, Any] | None) -> str:
    """What the iid bound alone would have said about tau, at 95 %."""
    if bounds is None:
        return ""
    naive = bounds.get("naive") or {}
    right, published = naive.get("crlb_iid"), naive.get("crlb_iid_one_percent_step")
    parts = []
    if right and right.get("tau_s"):
        parts.append(
            "the iid Cramer-Rao bound alone would have said "
            f"± {number(1.96e3 * right['tau_s'], 2)} ms"
        )
    if published and published.get("tau_s"):
        said = f"± {number(1.96e3 * published['tau_s'], 2)} ms"
        parts.append(
            f"(with the published 1 % steps {said})"
            if parts
            else f"the iid Cramer-Rao bound with the published 1 % steps would have said {said}"
        )
    return " ".join(parts)


# --------------------------------------------------------------------------- warnings


def alerts(saved: Saved) -> list[tuple[str, str]]:
    """(kind, sentence) for the top of the page: ``bad`` for what failed, else ``note``."""
    found: list[tuple[str, str]] = []
    if saved.fit is not None and not saved.fit["converged"]:
        found.append(("bad", f"The least-squares fit did not converge. {saved.fit['status']}"))
    if saved.posterior is not None and not saved.posterior["converged"]:
        found.append(
            (
                "bad",
                "The posterior did not converge, so its intervals must not be quoted "
                f"({saved.posterior['status']}). Continue it with --resume and more steps.",
            )
        )
    n = len(saved.campaign["experiments"])
    missed = _missed(saved)
    if missed > n / 2:
        found.append(
            (
                "bad",
                f"The model misses {missed} of {n} traces by more than their noise explains. The "
                "intervals below take the model as right; what it leaves out is in none of them.",
            )
        )
    bases = {name: entry["basis_sha256"] for name, entry in saved.run["commands"].items()}
    newest = bases.get(saved.run["last"])
    stale = [name for name, basis in bases.items() if newest and basis != newest]
    if stale:
        found.append(
            (
                "bad",
                f"The results of {list_words(stale)} rest on other data or settings than those of "
                f"{saved.run['last']}; run them again before comparing.",
            )
        )
    notes = list(saved.campaign.get("remarks", []))
    for part in (saved.fit, saved.posterior):
        notes += part.get("warnings", []) if part else []
    if saved.bounds:
        for method, entry in saved.bounds["methods"].items():
            status = entry.get("status", "ok")
            if method == "crlb_iid_one_percent_step":  # its caveats stand in the table of methods
                continue
            if status != "ok" and "lower bound" not in status and "upper limit" not in status:
                label = figures.METHOD_LABELS.get(method, method)
                notes.append(f"{label}: {status}")
    seen: set[str] = set()
    for note in notes:
        if note not in seen and not any(note == text for _, text in found):
            seen.add(note)
            found.append(("note", _sentence(note)))
    return found


def _missed(saved: Saved) -> int:
    """How many traces the model does not describe."""
    warnings = saved.fit["warnings"] if saved.fit else []
    return sum("does not describe the trace" in w for w in warnings)


def _sentence(text: str) -> str:
    text = text.strip()
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else text + "."


# --------------------------------------------------------------------------- sections


class _Pictures:
    """Makes figures, remembers their files and gives their form in the page."""

    def __init__(self, folder: Path | None, progress: Callable[[float, str], None]) -> None:
        self.folder = folder
        self.progress = progress
        self.overlay_bytes = 0
        self.pixel_bytes = 0
        self.done = 0
        self.total = 1

    def add(self, key: str, figure: Any, caption: str, overlay: bool = False) -> Picture:
        drawing = figures.svg(figure)
        self.done += 1
        self.progress(min(0.99, self.done / self.total), f"figure {key}")
        if self.folder is not None:
            (self.folder / f"{key}.svg").write_text(drawing, encoding="utf-8")
            (self.folder / f"{key}.png").write_bytes(figures.png(figure))
        body = inline_svg(drawing, key, caption)
        if overlay:
            self.overlay_bytes += len(body)
            if self.overlay_bytes > MOST_OVERLAYS:
                data = base64.b64encode(figures.png(figure, 90)).decode("ascii")
                self.pixel_bytes += len(data)
                safe = html.escape(caption, quote=True)
                body = f'<img alt="{safe}" src="data:image/png;base64,{data}">'
            if self.pixel_bytes > MOST_PIXELS:
                body = f"<p>Drawn in figures/{key}.svg, to keep this page small.</p>"
        return Picture(key, caption, body)


def _measured(saved: Saved, pictures: _Pictures) -> Section:
    campaign = saved.campaign
    rows = campaign["experiments"]
    intervals = sorted({e["interval_s"] for e in rows})
    n_fall = sum(e["commanded_off_s"] is not None for e in rows)
    answer = (
        f"{len(rows)} step experiment{'s' * (len(rows) != 1)} with "
        f"{campaign['n_samples']} samples in use, one every "
        f"{list_words([f'{1e3 * h:g} ms' for h in intervals])}; total flow "
        f"{_range(rows, 'total_flow_L_min')} L/min, test gas "
        f"{_range(rows, 'concentration_percent')} %."
    )
    paragraphs = []
    if n_fall == 0:
        paragraphs.append(
            "Only the step up was recorded: there is no end of the step, so no end time is "
            "estimated."
        )
    elif n_fall < len(rows):
        paragraphs.append(f"{n_fall} of {len(rows)} experiments also recorded the step down.")
    if campaign.get("same_flow") and len(rows) > 1:
        paragraphs.append(
            "All experiments share one total flow. The valve's time constant τᵥ and the volume V "
            "then act alike and cannot be separated by these data."
        )
    for name, info in campaign.get("side_information", {}).items():
        symbol, unit, factor = figures.parameter_words(name, saved.unit)
        paragraphs.append(
            f"Known beforehand and used as a prior: {symbol} = {factor * info['mean']:g} ± "
            f"{factor * info['sd']:g} {unit}."
        )
    unit = saved.unit
    columns = [
        "experiment", "samples used", "interval (ms)", "length (s)", "flow (L/min)",
        "test gas (%)", "on (s)", "off (s)", f"baseline ({unit})", f"step ({unit})",
        f"noise ({unit})", "file",
    ]  # fmt: skip
    table = Table(
        "experiments",
        "The experiments as they were understood. On and off are the commanded times; noise is "
        "that of the baseline.",
        columns,
        [
            [
                e["experiment"], e["used"], 1e3 * e["interval_s"], e["duration_s"],
                e["total_flow_L_min"], e["concentration_percent"], e["commanded_on_s"],
                e["commanded_off_s"], e["baseline_V"], e["step_V"], e["noise_V"], e["file"],
            ]
            for e in rows
        ],
    )  # fmt: skip
    return Section("measured", "What was measured", answer, paragraphs, [table])


def _range(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    values = [row[key] for row in rows]
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"


def _fit(saved: Saved, pictures: _Pictures) -> Section | None:
    fit = saved.fit
    if fit is None:
        return None
    unit = saved.unit
    shown, factor = ("mV", 1e3) if unit == "V" else (unit, 1.0)
    rms = factor * fit["rms_V"]
    missed = _missed(saved)
    answer = f"The model leaves an RMS residual of {number(rms)} {shown} over all samples. "
    answer += (
        f"In {missed} of {len(saved.campaign['experiments'])} experiments it does not describe "
        "the trace within the noise; the figures below show where."
        if missed
        else "No experiment shows a misfit that its noise would not explain."
    )
    paragraphs = []
    if "tau_s" in fit["at_bound"]:
        paragraphs.append(
            "The best τ sits at the lower edge of its search range. That is an answer: the data do "
            "not exclude smaller values, and the least-squares number by itself must be read as a "
            "limit."
        )
    others = [_symbol(n) for n in fit["at_bound"] if n != "tau_s"]
    if others:
        paragraphs.append(
            f"The best value of {list_words(others)} sits on the edge of its search range: widen "
            "it ([fit] bounds in the settings), or distrust it."
        )
    if not fit["swarms"].get("agree", True):
        paragraphs.append("Independent swarms ended in different places; the best one is shown.")
    else:
        n = len(fit["swarms"].get("swarms", []))
        paragraphs.append(f"{n} independent particle swarms ended, after refinement, at one place.")
    if fit.get("euler"):
        change = fit["euler"]["difference"]
        paragraphs.append(
            "Solved by forward Euler instead of exactly, as in the published analysis, the same "
            f"fit moves τ by {number(1e3 * change['tau_s'], 2)} ms, τᵥ by "
            f"{number(1e3 * change['tau_v_s'], 2)} ms and V by {number(change['V_mL'], 2)} mL."
        )
    content: list[Table | Picture] = []
    for k, trace in enumerate(saved.traces):
        content.append(
            pictures.add(
                f"overlay_{k + 1}",
                figures.overlay(trace),
                f"Experiment {trace.name}: {60e-3 * trace.total_flow:.3g} L/min, "
                f"{100 * trace.concentration:.3g} % test gas; RMS {number(factor * trace.rms)} "
                f"{shown}. Blue: all samples, as the range in each stretch of time.",
                overlay=True,
            )
        )
    if len(saved.traces) > 1:
        content.append(
            pictures.add(
                "rms",
                figures.rms_bars(saved.traces),
                "RMS residual of each experiment, with what the noise law alone would leave.",
            )
        )
    p = fit["parameters"]
    rows = [
        [_symbol(name), figures.SHARED_LABELS[name][1], figures.SHARED_LABELS[name][2] * p[name]]
        for name in figures.SHARED_LABELS
    ]
    rows += [
        [*figures.parameter_words(name, unit)[:2], figures.parameter_words(name, unit)[2] * p[name]]
        for name in ("phi", "sigma0_V", "sigma1_V")
        if name in p
    ]
    content.append(
        Table(
            "fit-shared",
            "Least-squares values of the shared parameters, and the noise of the residuals. For "
            "intervals see the next section.",
            ["parameter", "unit", "value"],
            rows,
            digits=5,
        )
    )
    rms_of = fit.get("rms_per_experiment_V", {})
    content.append(
        Table(
            "fit-experiments",
            "Least-squares values of each experiment.",
            ["experiment", f"y₀ ({unit})", f"β ({unit})", "t₀ (s)", "t_f (s)", f"RMS ({shown})"],
            [
                [
                    name, values.get("y0_V"), values.get("beta_V"), values.get("t0_s"),
                    values.get("tf_s"), factor * rms_of[name] if name in rms_of else None,
                ]
                for name, values in p["experiments"].items()
            ],
            digits=5,
        )
    )  # fmt: skip
    return Section("fit", "How well does the model fit", answer, paragraphs, content)


def _symbol(name: str) -> str:
    return figures.parameter_words(name)[0]


def _tau(saved: Saved, pictures: _Pictures) -> Section | None:
    posterior, bounds = saved.posterior, saved.bounds
    if posterior is None and bounds is None:
        return None
    settings = _settings(saved)
    head = headline(posterior, bounds, settings)
    answer = "" if head is None else f"τ = {head.tau}."
    if head is not None and head.is_limit and head.limit:
        answer += f" Zero is not excluded, so quote it as an upper limit: τ < {head.limit} (95 %)."
    paragraphs = []
    content: list[Table | Picture] = []
    if head is not None and head.naive:
        paragraphs.append(_sentence(head.naive))
    if bounds is not None:
        paragraphs += _why(saved)
        content.append(
            pictures.add(
                "intervals",
                figures.intervals(bounds),
                "Every method side by side: 68 % (thick) and 95 % (thin) intervals; the marker is "
                "each method's estimate. Orange: the classical bounds under iid noise.",
            )
        )
        content.append(_method_table(bounds))
        content.append(_assumption_table(bounds))
        study = bounds.get("step_study")
        if study:
            is_replica = abs(bounds["naive"]["at"]["tau_v_s"] - 0.8577) < 0.05
            content.append(
                pictures.add(
                    "step_study",
                    figures.step_study(study, PUBLISHED_3SD if is_replica else None),
                    "The classical bound against the step of the finite difference. It is right "
                    "only where the curves are flat: a step of 1 % moves the switch times by "
                    "tenths of a second. Open markers: a step so small that forward Euler sees no "
                    "change of the switch times at all."
                    + (" Stars: the published bounds." if is_replica else ""),
                )
            )
    if posterior is not None:
        if saved.chains is not None:
            content.append(
                pictures.add(
                    "corner",
                    figures.corner(*saved.chains, unit=saved.unit),
                    "Joint posterior of the shared parameters: regions of 39, 68 and 95 %; dashed "
                    "lines mark the median and the 95 % interval.",
                )
            )
        content.append(_posterior_table(saved, shared=True))
        rows = posterior.get("tau_under_priors", [])
        if rows:
            content.append(_prior_table(rows))
            paragraphs.append(
                "Because the data see τ mainly through its square, the prior matters near zero. "
                "The table of priors shows how much."
            )
    return Section("tau", "What is the sensor's time constant", answer, paragraphs, content)


def _settings(saved: Saved) -> dict[str, Any]:
    commands = saved.run["commands"]
    for name in ("posterior", "analyze", saved.run["last"]):
        if name in commands:
            return commands[name].get("settings") or {}
    return {}


def _why(saved: Saved) -> list[str]:
    """Why the classical bound misleads here, in numbers of this campaign."""
    assert saved.bounds is not None
    naive = saved.bounds.get("naive") or {}
    right, published = naive.get("crlb_iid") or {}, naive.get("crlb_iid_one_percent_step") or {}
    said = []
    at = naive.get("at", {}).get("tau_s")
    if right.get("tau_s") and published.get("tau_s"):
        ratio = right["tau_s"] / published["tau_s"]
        if ratio < 1.3:
            said.append(
                "The published recipe for the classical bound moves every parameter by 1 %. For "
                "the switch times that depends on where time starts, so it is no bound: here it "
                f"gives {number(1 / ratio, 2)} times the value with correct derivatives."
            )
    if right.get("tau_s") and published.get("tau_s") and ratio >= 1.3:
        said.append(
            f"At τ = {number(1e3 * at, 3)} ms the classical bound for white noise, with its "
            f"derivatives taken correctly, is {number(ratio, 2)} times that of the published "
            "recipe, which moves every parameter by 1 %. For the switch times 1 % is tenths of a "
            "second, far too much: a slower sensor and a later switch look almost alike, and a "
            "step that large hides it."
        )
    coloured = naive.get("crlb_ar1") or {}
    if right.get("tau_v_s") and coloured.get("tau_v_s"):
        ratio = coloured["tau_v_s"] / right["tau_v_s"]
        phi = (saved.residuals or {}).get("ar1", {}).get("phi")
        said.append(
            "White noise is the second assumption that fails: neighbouring residuals are alike"
            + (f" (φ = {number(phi, 3)})" if phi is not None else "")
            + f", which makes the bound of τᵥ {number(ratio, 2)} times wider."
        )
    return said


def _method_table(bounds: Mapping[str, Any]) -> Table:
    rows: list[list[Any]] = []
    marked: list[int] = []
    for name, (symbol, unit, factor) in figures.SHARED_LABELS.items():
        for method, entry in bounds["methods"].items():
            row = entry["parameters"].get(name) or {}
            values = [
                None if row.get(key) is None else factor * row[key]
                for key in ("estimate", "sd", "lo68", "hi68", "lo95", "hi95", "lo997", "hi997")
            ]
            if method == "posterior":
                marked.append(len(rows))
            label = figures.METHOD_LABELS.get(method, method)
            rows.append([f"{symbol} ({unit})", label, *values])
    columns = [
        "parameter", "method", "estimate", "sd", "68 % low", "68 % high", "95 % low", "95 % high",
        "99.7 % low", "99.7 % high",
    ]  # fmt: skip
    return Table(
        "methods",
        "Intervals by every method. No standard deviation is given where the estimate sits at its "
        "limit, because ± would mislead there.",
        columns,
        rows,
        marked=marked,
    )


def _assumption_table(bounds: Mapping[str, Any]) -> Table:
    rows = [
        [
            figures.METHOD_LABELS.get(method, method),
            entry["assumes"],
            entry.get("reference", ""),
            "" if entry.get("status", "ok") == "ok" else entry["status"],
        ]
        for method, entry in bounds["methods"].items()
    ]
    return Table(
        "assumptions", "What each method assumes.", ["method", "assumes", "source", "remark"], rows
    )


def _posterior_table(saved: Saved, shared: bool) -> Table:
    assert saved.posterior is not None
    keys = ("mean", "sd", "q2.5", "q16", "q50", "q84", "q97.5")
    rows: list[list[Any]] = []
    for name, row in saved.posterior["parameters"].items():
        is_local = name.partition("[")[0] in ("y0_V", "beta_V", "t0_s", "tf_s")
        if row is None or is_local == shared:
            continue
        symbol, unit, factor = figures.parameter_words(name, saved.unit)
        values = [factor * row[key] for key in keys]
        if not shared:
            values = values[:2] + [values[2], values[4], values[6]]
        rows.append([symbol, unit, *values, row["ess_bulk"], row["ess_tail"], row["r_hat"]])
    percent = ["2.5 %", "16 %", "50 %", "84 %", "97.5 %"] if shared else ["2.5 %", "50 %", "97.5 %"]
    return Table(
        "posterior-shared" if shared else "posterior-experiments",
        "Posterior of the shared parameters: mean, standard deviation, percentiles, effective "
        "sample sizes and R-hat."
        if shared
        else "Posterior of each experiment's own parameters.",
        ["parameter", "unit", "mean", "sd", *percent, "ESS bulk", "ESS tail", "R-hat"],
        rows,
        digits=5,
    )


def _prior_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    words = {
        "flat": "flat",
        "half_normal": "half-normal (default)",
        "log_uniform_floored": "log-uniform, flat below its floor",
    }
    return Table(
        "priors-on-tau",
        "τ under three priors, from the same draws by reweighting (ms). With fewer than about 400 "
        "effective draws a row is rough.",
        [
            "prior on τ", "95 % low", "95 % high", "densest 95 % low", "densest 95 % high",
            "95 % upper limit", "99 % upper limit", "effective draws",
        ],
        [
            [
                words.get(r["prior"], r["prior"]),
                *(
                    _ms(r[key])
                    for key in (
                        "lo95_s", "hi95_s", "hdi_lo95_s", "hdi_hi95_s", "upper95_s", "upper99_s",
                    )
                ),
                r["n_effective"],
            ]
            for r in rows
        ],
        digits=3,
    )  # fmt: skip


def _noise(saved: Saved, pictures: _Pictures) -> Section | None:
    residuals = saved.residuals
    if residuals is None:
        return None
    answer = ("Yes. " if residuals["adequate"] else "Not fully. ") + _sentence(residuals["verdict"])
    test = residuals["variance_vs_concentration"]["breusch_pagan"]
    before, after = (residuals["durbin_watson"][k] for k in ("before", "after"))
    paragraphs = [
        f"Residuals that follow each other closely carry less information than their number "
        f"suggests. The Durbin-Watson statistic, 2 for independent noise, is {before:.2f} before "
        f"and {after:.2f} after the AR(1) part is taken out.",
    ]
    if test.get("p_value") is not None:
        verb = "does" if test["p_value"] < 0.05 else "does not clearly"
        paragraphs.append(
            f"The spread {verb} grow with concentration (Breusch-Pagan test on {test['n']} samples "
            f"far enough apart to be independent, p {_equals(test['p_value'])})."
        )
    content: list[Table | Picture] = [
        pictures.add(
            "autocorrelation",
            figures.autocorrelation(residuals, saved.traces),
            "Autocorrelation of the residuals of all experiments in a row, with the curve of the "
            "fitted AR(1); below, the residuals themselves, shades alternating from experiment to "
            "experiment.",
        ),
        pictures.add(
            "spread",
            figures.spread(residuals),
            "Standard deviation of the residuals in bins of concentration, with the fitted law.",
        ),
        pictures.add(
            "histogram",
            figures.histogram(residuals, saved.fit["rms_V"] if saved.fit else _rms(residuals)),
            f"Distribution of the residuals ({residuals['histogram']['note']}).",
        ),
    ]
    lb = residuals["ljung_box"]
    content.append(
        Table(
            "ljung-box",
            "Ljung-Box test for correlation up to a lag, before and after whitening by the AR(1). "
            "With many samples a small p-value also comes from correlations too small to matter.",
            ["lag (samples)", "Q before", "p before", "Q after", "p after"],
            [
                [lag, b, pb, a, pa]
                for lag, b, pb, a, pa in zip(
                    lb["lags"],
                    lb["before"]["statistic"],
                    lb["before"]["p_value"],
                    lb["after"]["statistic"],
                    lb["after"]["p_value"],
                    strict=True,
                )
            ],
        )
    )
    unit = saved.unit
    content.append(
        Table(
            "noise-experiments",
            "Residuals of each experiment.",
            [
                "experiment", f"RMS ({unit})", "lag-one correlation",
                f"sd, baseline ({unit})", f"sd, plateau ({unit})",
            ],
            [
                [
                    name, e["rms_V"],  e["lag_one"], e["baseline_sd_V"],
                    e["plateau_sd_V"],
                ]
                for name, e in residuals["experiments"].items()
            ],
        )
    )  # fmt: skip
    return Section("noise", "Is the noise model adequate", answer, paragraphs, content)


def _equals(p: float) -> str:
    words = p_words(p)
    return words if words.startswith("below") else f"= {words}"


def _rms(residuals: Mapping[str, Any]) -> float:
    rows = residuals["experiments"].values()
    n = sum(e["n"] for e in rows)
    return float((sum(e["n"] * e["rms_V"] ** 2 for e in rows) / n) ** 0.5)


def _delays(saved: Saved, pictures: _Pictures) -> Section | None:
    delays = saved.delays
    if delays is None:
        return None
    said = []
    for side in ("start", "end"):
        line = delays.get(side)
        if line is None:
            said.append("No step down was recorded, so there is no delay of the end.")
        elif line["slope_L"] is None:
            said.append(f"Delay of the {side}: {line['status']}")
        else:
            lo, hi = line["ci95"]["slope_L"]
            text = (
                f"Delay of the {side} = {number(line['intercept_s'])} s + "
                f"{number(line['slope_L'])} L / Q (95 % interval of the slope {number(lo)} to "
                f"{number(hi)} L, R² = {line['r2']:.3f}, p {_equals(line['p_value'])}, "
                f"{line['n']} experiments)"
            )
            if line["outliers"]:
                text += f"; experiment {list_words(line['outliers'])} is an outlier and left out"
            said.append(text + ".")
    points = [
        [
            side, p["experiment"], p["inverse_flow_s_per_L"], p["delay_s"],
            p["studentised_residual"], p["bonferroni_p"], p["used"],
        ]
        for side in ("start", "end")
        if delays.get(side)
        for p in delays[side]["points"]
    ]  # fmt: skip
    content: list[Table | Picture] = []
    if points:
        content.append(
            pictures.add(
                "delays",
                figures.delays(delays, saved.concentration),
                "Delay between command and fitted switch against 1/Q, with the regression and its "
                "95 % prediction band. Open orange: outliers, found by their externally "
                "studentised residual and left out.",
            )
        )
        content.append(
            Table(
                "delays-table",
                "The delays. Studentised residuals are those of the regression on all experiments.",
                [
                    "switch", "experiment", "1/Q (s/L)", "delay (s)", "studentised residual",
                    "p (Bonferroni)", "used",
                ],
                points,
            )
        )  # fmt: skip
    weighted = [
        f"Weighted by the posterior variances of the switch times, the {side}'s slope is "
        f"{number(delays[side]['weighted']['slope_L'])} L."
        for side in ("start", "end")
        if delays.get(side) and (delays[side].get("weighted") or {}).get("slope_L") is not None
    ]
    return Section(
        "delays",
        "How do the delays depend on flow",
        " ".join(said),
        ["A constant part comes from valve and electronics; the slope is the volume that the gas "
         "has to fill before it reaches the sensor.", *weighted],
        content,
    )  # fmt: skip


def _computed(saved: Saved, pictures: _Pictures) -> Section:
    run = saved.run["commands"][saved.run["last"]]
    answer = (
        f"bayes-sensor {run['versions'].get('bayes-sensor', __version__)}, command "
        f"{saved.run['last']}, seed {run['seed']}, finished {run['finished']}."
    )
    paragraphs = []
    content: list[Table | Picture] = []
    if saved.posterior is not None:
        paragraphs.append(_sentence(saved.posterior["status"]))
        paragraphs += [_sentence(reason) for reason in saved.posterior.get("reasons", [])]
        paragraphs.append(
            "Convergence asks for R-hat below 1.01 between independent runs and for at least 400 "
            "effective draws, in bulk and in the tails, of every parameter."
        )
        if saved.chains is not None:
            content.append(
                pictures.add(
                    "traces",
                    figures.traces_and_ranks(*saved.chains, unit=saved.unit),
                    "The chains, and how often each chain's draws hold each rank among all draws. "
                    "When the chains agree the bars scatter about the middle of the grey band.",
                )
            )
        content.append(_posterior_table(saved, shared=False))
        content.append(
            Table(
                "priors",
                "Priors, in s, mL and the signal's unit.",
                ["parameter", "prior"],
                [[n, text] for n, text in saved.posterior.get("priors", {}).items()],
            )
        )
    content.append(
        Table(
            "settings",
            "Settings that were in force.",
            ["setting", "value"],
            [[key, _plain_text(value)] for key, value in _flattened(run.get("settings") or {})],
        )
    )
    content.append(
        Table(
            "files",
            "Input files and their SHA-256.",
            ["file", "sha-256"],
            [[name, value] for name, value in run.get("files_sha256", {}).items()],
        )
    )
    content.append(
        Table(
            "versions",
            "Versions.",
            ["package", "version"],
            [[name, version] for name, version in run["versions"].items()],
        )
    )
    content.append(
        Table(
            "runs",
            "What was run, and how long it took.",
            ["command", "finished", "seed", "exit code", "seconds"],
            [
                [name, e["finished"], e["seed"], e["exit_code"], sum(e["seconds"].values())]
                for name, e in saved.run["commands"].items()
            ],
        )
    )
    return Section("computed", "How it was computed", answer, paragraphs, content)


def _flattened(settings: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in settings.items():
        if isinstance(value, Mapping):
            rows += _flattened(value, f"{prefix}{key}.")
        else:
            rows.append((prefix + key, value))
    return rows


def _plain_text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_plain_text(v) for v in value)
    return {True: "yes", False: "no", None: "default"}.get(value, str(value))


# --------------------------------------------------------------------------- the page


def build_report(
    folder: str | Path,
    figure_folder: str | Path | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> str:
    """The page of a results directory, as text.

    ``figure_folder``: where to put every figure as SVG and PNG as well.

    Raises CampaignError if ``folder`` is not a results directory.
    """
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    saved = read_results(folder)
    pictures = _Pictures(None if figure_folder is None else Path(figure_folder),
                         progress or (lambda fraction, text: None))  # fmt: skip
    pictures.total = len(saved.traces) + 9
    makers = (_measured, _fit, _tau, _noise, _delays, _computed)
    sections = [s for s in (maker(saved, pictures) for maker in makers) if s is not None]
    places = resources.files("bayes_sensor") / "templates"
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string((places / "report.html.j2").read_text(encoding="utf-8"))
    return template.render(
        saved=saved,
        title=saved.name,
        version=saved.run["commands"][saved.run["last"]]["versions"].get("bayes-sensor", ""),
        finished=saved.run["commands"][saved.run["last"]]["finished"],
        head=headline(saved.posterior, saved.bounds, _settings(saved)),
        alerts=alerts(saved),
        sections=sections,
        css=Markup((places / "report.css").read_text(encoding="utf-8")),
        script=Markup((places / "report.js").read_text(encoding="utf-8")),
        is_table=lambda item: isinstance(item, Table),
        safe=Markup,
    )
