"""The figures of an analysis, as methods: records in, matplotlib out."""

from __future__ import annotations

from typing import Any

from bayes_sensor.analysis.findings import Findings
from bayes_sensor.campaign import CampaignError

_COMMANDS = {"fit": "fit", "residuals": "fit"}


class Plots:
    """Figures of an analysis.

    Each method returns a ``matplotlib`` Figure, which a notebook shows; where it takes ``ax`` and
    one is given, one panel is drawn there and the Axes are returned.  A result that is missing
    gives a panel that says so.

    >>> Plots.fit.__name__
    'fit'
    """

    def __init__(self, analysis: Findings) -> None:
        self._analysis = analysis

    def __repr__(self) -> str:
        """The names of the figures."""
        return f"plot: {', '.join(FIGURES)}"

    def _missing(self, part: str, ax: Any) -> Any:
        from bayes_sensor import figures

        command = _COMMANDS.get(part, part)
        why = "; ".join(note for note in self._analysis.notes if note.startswith(f"{part}: "))
        run = f"no {part} in these results; run analyze, or bayes-sensor {command}"
        return figures.no_data(why or run, ax)

    def fit(self, experiment: str | None = None, ax: Any = None) -> Any:
        """Measurement, model and residuals of one experiment (default: the first).

        With ``ax`` the whole record alone.  Raises CampaignError for an unknown experiment.
        """
        from bayes_sensor import figures

        if not self._analysis.traces:
            return self._missing("fit", ax)
        by_name = {trace.name: trace for trace in self._analysis.traces}
        name = next(iter(by_name)) if experiment is None else str(experiment)
        if name not in by_name:
            raise CampaignError(
                f"plot.fit: there is no experiment '{name[:80]}'; expected one of "
                f"{', '.join(by_name)}"
            )
        if ax is None:
            return figures.overlay(by_name[name])
        figures.overlay_panel(ax, by_name[name])
        return ax

    def residuals(self, ax: Any = None) -> Any:
        """Distribution of all residuals with the normal law of the same RMS."""
        from bayes_sensor import figures

        found, fit = self._analysis.residuals, self._analysis.fit
        if found is None or fit is None:
            return self._missing("residuals", ax)
        return figures.histogram(found, fit.rms, ax)

    def acf(self, ax: Any = None) -> Any:
        """Autocorrelation of the residuals with the curve of the AR(1) noise law.

        With ``ax`` the short lags alone.
        """
        from bayes_sensor import figures

        if self._analysis.residuals is None:
            return self._missing("residuals", ax)
        if ax is None:
            return figures.autocorrelation(self._analysis.residuals, self._analysis.traces)
        figures.autocorrelation_panel(ax, self._analysis.residuals)
        return ax

    def corner(self) -> Any:
        """Joint posterior of the parameters that all experiments share."""
        from bayes_sensor import figures

        posterior = self._analysis.posterior
        if posterior is None:
            return self._missing("posterior", None)
        unit = posterior.problem.campaign.signal_unit
        return figures.corner(*figures.named_chains(posterior), unit=unit)

    def intervals(self, parameter: str | None = None, ax: Any = None) -> Any:
        """Every bound method side by side.

        With ``ax`` one ``parameter`` alone (flat name, default the first).  Raises CampaignError
        for an unknown one.
        """
        from bayes_sensor import figures

        bounds = self._analysis.bounds
        if bounds is None:
            return self._missing("bounds", ax)
        shown = list(figures.labels_of_bounds(bounds.to_json()))
        name = shown[0] if parameter is None else parameter
        if name not in shown:
            raise CampaignError(
                f"plot.intervals: there are no intervals of '{str(name)[:80]}'; expected one of "
                f"{', '.join(shown)}"
            )
        if ax is None and parameter is None:
            return figures.intervals(bounds)
        return figures.one_interval(bounds, name, ax)

    def delays(self, side: str = "start", ax: Any = None) -> Any:
        """Delays of the switches against 1/Q with the regression.

        With ``ax`` one ``side`` alone, ``start`` or ``end``.
        """
        from bayes_sensor import figures

        found = self._analysis.delays
        if found is None:
            return self._missing("delays", ax)
        if side not in ("start", "end"):
            raise CampaignError(
                f"plot.delays: expected side to be 'start' or 'end', but got '{str(side)[:80]}'"
            )
        concentration = {e.name: e.concentration for e in self._analysis.campaign}
        if ax is None:
            return figures.delays(found, concentration)
        if not (found.to_json()[side] or {}).get("points"):
            return figures.no_data(f"no {side} delay: no such commands are known", ax)
        figures.delay_panel(ax, found, concentration, side)
        return ax

    def gap(self, ax: Any = None) -> Any:
        """Probabilities of the explanations of the gap, and of their families.

        With ``ax`` the explanations alone.
        """
        from bayes_sensor import figures

        if self._analysis.gap is None:
            return self._missing("gap", ax)
        if ax is None:
            return figures.gap_which(self._analysis.gap)
        figures.explanation_panel(ax, self._analysis.gap)
        return ax


FIGURES = ("fit", "residuals", "acf", "corner", "intervals", "delays", "gap")
