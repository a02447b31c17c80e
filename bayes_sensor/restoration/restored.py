"""The restored input as a record: values with bands, resolution, noise, warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from bayes_sensor.campaign import FloatArray
from bayes_sensor.display import card
from bayes_sensor.io.json_files import plain
from bayes_sensor.restoration.innovations import Innovations
from bayes_sensor.restoration.state_space import Model

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("time_s", "value", "lo68", "hi68", "lo95", "hi95")
BANDS = (0.16, 0.84, 0.025, 0.975)
"""probabilities below lo68, hi68, lo95 and hi95"""
PERCENTS = (2.5, 50.0, 97.5)


@dataclass(frozen=True, eq=False)
class Restored:
    """The input of a slow sensor over time, with bands that hold every uncertainty."""

    t: FloatArray
    """(n,) s, times of the record"""
    recorded: FloatArray
    """(n,) the record; NaN where no sample was taken"""
    mean: FloatArray
    """(n,) of the input, in the record's unit"""
    sd: FloatArray
    """(n,) of the input, from noise, roughness and lags together"""
    nonnegative: bool
    """whether the input is known not to be negative"""
    unit: str
    resolution: FloatArray
    """(n_draws,) s, half the period at which signal and noise are equal after the lags; infinite
    where the noise is larger at every period"""
    lags: FloatArray
    """(n_draws, n_lags) s"""
    models: tuple[Model, ...]
    """(n_draws,) in standard deviations of the record"""
    spread: float
    """standard deviation of the record, in its unit"""
    innovations: Innovations
    interval: float
    """s, at which phi holds"""
    lag_source: str
    remarks: tuple[str, ...] = ()
    """of the lags and of the reader, in sentences"""
    doubts: tuple[str, ...] = ()
    """what does not fit together in record, lags and options, in sentences"""

    @property
    def resolution_s(self) -> float | None:
        """Median resolution in s; None where nothing is resolved."""
        median = float(np.median(self.resolution))
        return median if np.isfinite(median) else None

    @property
    def value(self) -> FloatArray:
        """(n,) median of the input."""
        return self.quantile(0.5)

    def quantile(self, probability: float) -> FloatArray:
        """(n,) quantiles of the input at every time by itself.

        Where the input is known not to be negative, none lies below 0.
        """
        found = self.mean + norm.ppf(probability) * self.sd
        return np.asarray(np.maximum(found, 0.0) if self.nonnegative else found)

    def table(self) -> pd.DataFrame:
        """The columns of restored.csv: time_s, value, lo68, hi68, lo95, hi95."""
        import pandas as pd

        columns = [self.t, self.value, *(self.quantile(p) for p in BANDS)]
        return pd.DataFrame(dict(zip(COLUMNS, columns, strict=True)))

    @property
    def bands(self) -> dict[str, Any]:
        """The columns of :meth:`table` where the input is lowest, highest and least known, and the
        median half widths of the bands."""
        table = self.table()
        moments = {
            "lowest": int(np.argmin(self.value)),
            "highest": int(np.argmax(self.value)),
            "least_known": int(np.argmax(self.sd)),
        }
        return {
            **{name: table.iloc[i].to_dict() for name, i in moments.items()},
            **{
                f"median_half_width{level}": float(
                    np.median(table[f"hi{level}"] - table[f"lo{level}"]) / 2.0
                )
                for level in (68, 95)
            },
        }

    @property
    def warnings(self) -> list[str]:
        """What to be careful about, in sentences."""
        found = list(self.doubts)
        if self.resolution_s is None:
            found.append(
                "noise is larger than signal at every period: nothing is restored beyond what the "
                "record says by itself"
            )
        return found + self.innovations.sentences

    def to_json(self) -> dict[str, Any]:
        """The content of restored.json."""
        slowest = self.lags.max(axis=1)
        phi = np.array([model.phi for model in self.models])
        low = self.spread * np.array([model.sigma for model in self.models])
        growth = np.array([model.growth for model in self.models])
        resolution = self.resolution_s
        return dict(
            plain(
                {
                    "signal_unit": self.unit,
                    "resolution_s": resolution,
                    "lag_s": _percentiles(slowest),
                    "lags_s": [_percentiles(column) for column in np.sort(self.lags, axis=1).T],
                    "lag_source": self.lag_source,
                    "noise": {
                        "phi": _percentiles(phi),
                        "phi_interval_s": self.interval,
                        "sigma": _percentiles(low),
                        "sigma_at_highest": _percentiles(low * np.sqrt(1.0 + growth**2)),
                    },
                    "input": {
                        "sd": _percentiles(
                            self.spread * np.array([model.input_sd for model in self.models])
                        ),
                        "length_s": _percentiles(np.array([m.length for m in self.models])),
                        "smooth_share": float(np.mean([m.order == 2 for m in self.models])),
                    },
                    "bands": self.bands,
                    "innovations": {
                        "n": self.innovations.n,
                        "sd": self.innovations.sd,
                        "kurtosis": self.innovations.kurtosis,
                        "correlation": self.innovations.correlation,
                        "p_value": self.innovations.p_value,
                        "largest": self.innovations.largest,
                        "largest_at_s": self.innovations.largest_at,
                        "largest_p_value": self.innovations.largest_p_value,
                    },
                    "nonnegative": self.nonnegative,
                    "n_samples": int(np.isfinite(self.recorded).sum()),
                    "n_draws": len(self.models),
                    "remarks": list(self.remarks),
                    "warnings": self.warnings,
                }
            )
        )

    @property
    def sentences(self) -> list[str]:
        """What came out, for people."""
        found = self.to_json()
        lag = found["lag_s"]
        resolution = self.resolution_s
        told = [
            f"lag {lag['q50']:.4g} s (95 %: {lag['q2.5']:.4g} to {lag['q97.5']:.4g} s), from "
            f"{self.lag_source}",
            "nothing is resolved: the noise is larger at every period"
            if resolution is None
            else f"resolution {resolution:.3g} s: what is shorter is not restored",
            f"noise {found['noise']['sigma']['q50']:.3g} {self.unit}, phi "
            f"{found['noise']['phi']['q50']:.3g} at {self.interval:.4g} s",
        ]
        return [*told, *self.remarks]

    def __repr__(self) -> str:
        """Size and resolution."""
        resolution = self.resolution_s
        words = "nothing resolved" if resolution is None else f"resolution {resolution:.3g} s"
        return f"Restored({len(self.t)} times; {words})"

    def _repr_html_(self) -> str:
        """HTML for a notebook."""
        return card("Restored input", [*self.sentences, *self.warnings])


def _percentiles(values: FloatArray) -> dict[str, float]:
    return {
        f"q{p:g}": float(v) for p, v in zip(PERCENTS, np.percentile(values, PERCENTS), strict=True)
    }


def resolution_of(models: Sequence[Model], interval: float, duration: float) -> FloatArray:
    """(n,) s, half the shortest period at which the input, after the lags, is as large as the
    noise; at least ``interval``, and infinite where it is nowhere."""
    frequencies = np.geomspace(0.1 / duration, 0.5 / interval, 4000)
    found = np.full(len(models), np.inf)
    for i, model in enumerate(models):
        signal = model.input_spectrum(frequencies) * model.gain_squared(frequencies)
        above = np.flatnonzero(signal >= model.noise_spectrum(frequencies, interval))
        if len(above):
            found[i] = 0.5 / frequencies[above[-1]]
    return found
