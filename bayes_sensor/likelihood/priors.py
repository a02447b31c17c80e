"""The prior law of one parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite, log, pi
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.display import record_card

LEAST_SHARE = 1e-9
"""of a prior's probability, which must lie where the parameter can be"""


@dataclass(frozen=True)
class Prior:
    """One parameter's prior law: ``kind`` with its two numbers.

    ``half_normal`` (scale), ``log_normal`` (median, sd of the logarithm), ``normal`` (mean, sd),
    ``uniform`` (low, high), ``log_uniform`` (low, high), ``flat`` (improper).

    Raises
    ------
    CampaignError
        If the kind is unknown or its numbers describe no law.
    """

    _repr_html_ = record_card

    kind: str
    a: float = 0.0
    b: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise CampaignError(
                f"a prior's kind must be one of {', '.join(KINDS)}, but is '{self.kind}'; "
                "correct it"
            )
        if self.kind == "flat":
            return
        what, holds = {
            "normal": ("a mean and a positive sd", self.b > 0),
            "half_normal": ("a positive scale", self.a > 0),
            "log_normal": ("a positive median and a positive sd", self.a > 0 and self.b > 0),
            "uniform": ("low < high", self.a < self.b),
            "log_uniform": ("0 < low < high", 0 < self.a < self.b),
        }[self.kind]
        if not (holds and isfinite(self.a) and isfinite(self.b)):
            raise CampaignError(f"prior {self}: expected {what}, all finite; correct its numbers")

    def log_density(self, value: FloatArray | float) -> FloatArray:
        """Natural log of the density at ``value`` (any shape); -inf outside; 0 for ``flat``."""
        x = np.asarray(value, dtype=float)
        positive = np.maximum(x, 1e-300)
        if self.kind == "flat":
            return np.zeros_like(x)
        if self.kind == "normal":
            return -0.5 * log(2 * pi) - log(self.b) - 0.5 * ((x - self.a) / self.b) ** 2
        if self.kind == "half_normal":
            inside = x >= 0
            density = 0.5 * log(2 / pi) - log(self.a) - 0.5 * (x / self.a) ** 2
        elif self.kind == "log_normal":
            inside = x > 0
            u = np.log(positive / self.a) / self.b
            density = -0.5 * log(2 * pi) - np.log(self.b * positive) - 0.5 * u * u
        else:
            inside = (x >= self.a) & (x <= self.b)
            if self.kind == "uniform":
                density = np.full_like(x, -log(self.b - self.a))
            else:
                density = -np.log(positive * log(self.b / self.a))
        return np.where(inside, density, -np.inf)

    def away(self, value: FloatArray | float) -> FloatArray:
        """Standard deviations between ``value`` (any shape) and the law's most likely value, of the
        logarithm for ``log_normal``; 0 inside and inf outside a law that is even.

        >>> float(Prior("normal", 4.0, 0.5).away(5.0)), float(Prior("uniform", 1.0, 2.0).away(1.5))
        (2.0, 0.0)
        """
        x = np.asarray(value, dtype=float)
        low, high = self.support
        if self.kind == "normal":
            return np.abs(x - self.a) / self.b
        if self.kind == "half_normal":
            found = x / self.a
        elif self.kind == "log_normal":
            found = np.abs(np.log(np.maximum(x, 1e-300) / self.a)) / self.b
        else:
            found = np.zeros_like(x)
        return np.where((x >= low) & (x <= high), found, np.inf)

    def scaled(self, factor: float) -> Prior:
        """The law of ``factor`` (positive) times the parameter.

        >>> Prior("uniform", 0.0, 60.0).scaled(0.5), Prior("log_normal", 4.0, 1.5).scaled(0.5).b
        (Prior(kind='uniform', a=0.0, b=30.0), 1.5)
        """
        if self.kind in ("half_normal", "log_normal"):
            return replace(self, a=factor * self.a)
        return replace(self, a=factor * self.a, b=factor * self.b)

    @cached_property
    def law(self) -> Any:
        """The same law as a frozen ``scipy.stats`` distribution; None for ``flat``."""
        from scipy import stats

        laws: dict[str, Callable[[], Any]] = {
            "flat": lambda: None,
            "half_normal": lambda: stats.halfnorm(scale=self.a),
            "log_normal": lambda: stats.lognorm(s=self.b, scale=self.a),
            "normal": lambda: stats.norm(self.a, self.b),
            "uniform": lambda: stats.uniform(self.a, self.b - self.a),
            "log_uniform": lambda: stats.loguniform(self.a, self.b),
        }
        return laws[self.kind]()

    @cached_property
    def width(self) -> float:
        """Half the distance between its 16th and 84th percentile; nan for ``flat``."""
        if self.law is None:
            return float("nan")
        low, high = self.law.ppf([0.16, 0.84])
        return 0.5 * float(high - low)

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value allowed."""
        if self.kind in ("flat", "normal"):
            return -np.inf, np.inf
        return (0.0, np.inf) if self.kind in ("half_normal", "log_normal") else (self.a, self.b)

    def check_within(self, low: float, high: float, where: str) -> None:
        """Raise CampaignError where the law leaves a parameter from ``low`` to ``high`` nothing.

        ``where``: words that begin the message.
        """
        if self.law is None or self.law.cdf(high) - self.law.cdf(low) > LEAST_SHARE:
            return
        above = f"above {low:g}" if np.isinf(high) else f"between {low:g} and {high:g}"
        raise CampaignError(
            f"{where}: expected a prior with values {above}, which is the range of this parameter, "
            f"but got {self}; correct its numbers or leave it out"
        )

    def __str__(self) -> str:
        numbers = {"flat": "", "half_normal": f"({self.a:g})"}
        return self.kind.replace("_", "-") + numbers.get(self.kind, f"({self.a:g}, {self.b:g})")


KINDS = ("flat", "normal", "half_normal", "log_normal", "uniform", "log_uniform")
