"""The results of an analysis as text, in the manner of a fit report."""

from __future__ import annotations

from math import floor, log10
from typing import Any, NamedTuple

import numpy as np

from bayes_sensor.analysis.findings import Findings
from bayes_sensor.campaign import counted
from bayes_sensor.display import shown
from bayes_sensor.rig.named_values import unit_of

LEAST_CORRELATION = 0.5
"""magnitude from which a correlation is listed"""
MOST_CORRELATIONS = 10
MOST_WARNINGS = 6


class ParameterRow(NamedTuple):
    """One parameter of the summary; None for what is not known."""

    name: str
    value: float | None
    """median of the posterior, or the estimate of the fit"""
    sd: float | None
    low: float | None
    """95 % interval"""
    high: float | None
    unit: str
    remark: str = ""

    @property
    def cells(self) -> list[Any]:
        """Its columns."""
        return [*self[:5], f"{self.unit} {self.remark}".strip()]


def answer_lines(analysis: Findings) -> list[str]:
    """What the command line says first: the lags with their intervals, and the gap's verdict."""
    from bayes_sensor.report import chain_words, headline

    lines = []
    record = None if analysis.posterior is None else analysis.posterior.to_json()
    gap = None if analysis.gap is None else analysis.gap.to_json()
    found = headline(record, analysis.bounds_json, analysis.settings, gap)
    if found is not None:
        lines.append(str(found))
        if record is not None and not found.hidden:
            lines.append(chain_words(record, bool(found.without)))
    elif analysis.fit is not None:
        lines.append(repr(analysis.fit))
    if analysis.gap is not None:
        lines.append(f"gap: {analysis.gap.verdict.sentence}")
    return lines


def parameter_rows(analysis: Findings) -> list[ParameterRow]:
    """Every parameter that varies; lags by size where it is not known which is the sensor's."""
    from bayes_sensor.figures import told_apart

    unit = analysis.campaign.signal_unit
    posterior, fit = analysis.posterior, analysis.fit
    if posterior is not None:
        rows, held = posterior.rows, analysis.problem.held
        made = []
        for name in told_apart(rows):
            row, own = rows[name], unit_of(name.split("[")[0], unit)
            is_held = (analysis.problem.place_of(name) or name) in held
            sd, low, high = (None if is_held else row[key] for key in ("sd", "q2.5", "q97.5"))
            remark = "(held)" if is_held else ""
            made.append(ParameterRow(_plain(name, unit), row["q50"], sd, low, high, own, remark))
        return made
    if fit is None:
        return []
    return [
        ParameterRow(
            _plain(name, unit), None if name in fit.unseen else float(value), None, None, None,
            unit_of(name.split("[")[0], unit),
            "(too small to be seen)" if name in fit.unseen else "",
        )
        for name, value in zip(fit.names, fit.theta_hat, strict=True)
    ]  # fmt: skip


def summary_text(analysis: Findings) -> str:
    """The whole text."""
    parts = [
        ("Campaign", _campaign(analysis)),
        ("Answer", [*answer_lines(analysis), *analysis.notes]),
        ("Fit statistics", _statistics(analysis)),
        ("Parameters", _parameters(analysis)),
        ("Correlations", _correlations(analysis)),
        ("Bounds of tau", _bounds(analysis)),
        ("Warnings", _warnings(analysis)),
    ]
    lines = []
    for title, content in parts:
        if content:
            lines += [f"[[{title}]]", *(f"    {line}" for line in content)]
    return "\n".join(lines)


def _plain(name: str, unit: str) -> str:
    """A flat name without the unit that stands in a column of its own."""
    kind, bracket, rest = name.partition("[")
    words = kind.split("_")
    if len(words) > 1 and unit_of(kind, unit) != "1" and "per" not in words:
        words = words[:-1]
    return "_".join(words) + bracket + rest


def _campaign(analysis: Findings) -> list[str]:
    campaign = analysis.campaign
    about = f"{counted(len(campaign), 'experiment')}, {campaign.n_samples} samples used"
    return [campaign.title, about, f"signal in {campaign.signal_unit}"]


def _statistics(analysis: Findings) -> list[str]:
    fit, unit = analysis.fit, analysis.campaign.signal_unit
    if fit is None:
        return []
    lines = [
        f"{'method':<20}= least squares: particle swarm, trust-region refinement",
        f"{'samples':<20}= {fit.n_samples}",
        f"{'parameters':<20}= {analysis.problem.layout.n_mean}",
        f"{'RMS residual':<20}= {shown(fit.rms)} {unit}",
    ]
    if fit.noise is not None:
        lines.append(f"{'noise, quiet parts':<20}= {shown(fit.noise)} {unit}")
    if fit.misfit is not None:
        lines.append(f"{'misfit over noise':<20}= {shown(fit.misfit)}")
    if fit.n_lags is not None:
        lines.append(f"{'lags':<20}= {fit.n_lags.sentence}")
    lines.append(f"{'status':<20}= {fit.status}")
    if analysis.posterior is not None:
        posterior = analysis.posterior
        lines.append(f"{'posterior':<20}= {len(posterior.draws)} draws by {posterior.sampler}")
        lines.append(f"{'convergence':<20}= {posterior.convergence}")
    return lines


def _parameters(analysis: Findings) -> list[str]:
    rows = parameter_rows(analysis)
    if not rows:
        return []
    width = max(len(row.name) for row in rows)
    lines = []
    for row in rows:
        digits = _digits(row)
        line = f"{row.name + ':':<{width + 1}} {shown(row.value, digits):>10}"
        if row.sd is not None:
            line += f" +/- {shown(row.sd, 3):>9}"
            line += f"  95 % [{shown(row.low, digits)}, {shown(row.high, digits)}]"
        lines.append(" ".join([line, "" if row.unit == "1" else row.unit, row.remark]).rstrip())
    if analysis.posterior is not None and not analysis.posterior.converged:
        lines.append("(the posterior has not converged: take these numbers for a sketch)")
    return lines


def _digits(row: ParameterRow) -> int:
    """Significant digits that tell the ends of its interval apart."""
    if not row.sd or not row.value:
        return 4
    return max(4, floor(log10(abs(row.value) / row.sd)) + 3)


def _correlations(analysis: Findings) -> list[str]:
    from bayes_sensor.figures import told_apart

    if analysis.posterior is None:
        return []
    posterior, unit = analysis.posterior, analysis.campaign.signal_unit
    names = [name for name in told_apart(posterior.rows) if np.ptp(posterior.of(name)) > 0.0]
    if len(names) < 2:
        return []
    table = np.corrcoef(np.array([posterior.of(name) for name in names]))
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    listed = sorted(
        (pair for pair in pairs if abs(table[pair]) >= LEAST_CORRELATION),
        key=lambda pair: -abs(table[pair]),
    )
    lines = [
        f"C({_plain(names[j], unit)}, {_plain(names[i], unit)}) = {table[i, j]:+.3f}"
        for i, j in listed[:MOST_CORRELATIONS]
    ]
    if len(listed) > MOST_CORRELATIONS:
        lines.append(f"({len(listed) - MOST_CORRELATIONS} more above {LEAST_CORRELATION:g})")
    return lines


def _bounds(analysis: Findings) -> list[str]:
    lines = []
    for method, bound in analysis.bounds.methods.items() if analysis.bounds is not None else ():
        # a lag that cannot be assigned goes by its size
        for name in (n for n in bound.names if n.split("[")[0] == "tau_s" or n.startswith("lag_")):
            row = bound.row(name)
            lines.append(
                f"{method:<26} {name:<12} {shown(row['estimate']):>9}  "
                f"95 % [{shown(row['lo95'])}, {shown(row['hi95'])}] s"
            )
    return lines


def _warnings(analysis: Findings) -> list[str]:
    found = list(analysis.warnings)
    more = len(found) - MOST_WARNINGS
    return found[:MOST_WARNINGS] + ([f"({more} more in .warnings)"] if more > 0 else [])
