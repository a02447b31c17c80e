"""The record of a bound method: its name and label, what it assumes, how it behaves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence

Compute = Callable[[Evidence], Bound]


@dataclass(frozen=True, eq=False)
class BoundMethod:
    """A way to give every parameter an interval.

    ``compute`` returns the numbers.  Calling the record adds the name, the assumption and the
    reference to them.  The other fields tell compare_bounds, the coverage study, the figures and
    the report how to treat the method, so that they need not know its name.
    """

    name: str
    """key in ``bounds.json``"""
    label: str
    """in figures and tables"""
    assumes: str
    """one sentence; ``{noise}`` stands for the problem's noise law in words"""
    compute: Compute
    reference: str = ""
    """reference of the method"""

    noise: Literal["white", "fitted", "averaged", "residuals", "any"] = "any"
    """``white``: assumes white noise; ``fitted``: uses the problem's law at its maximum;
    ``averaged``: averages over that law; ``residuals``: estimates the spread of least squares from
    the residuals; ``any``: no assumption.  Decides which warnings the bound gets."""
    least_squares: bool = True
    """whether it is centred on the least-squares fit: it gives no value where that fit ended at
    the edge of its search"""
    both_orders: bool = False
    """whether it holds where tau and tau_v are close, so that the cascade may swap them"""
    needs_posterior: bool = False
    """whether it reads the draws of a posterior"""
    shared_only: bool = False
    """whether it gives no value for one experiment's own parameters"""
    published_recipe: bool = False
    """whether it is the published bound as we infer it, for comparison only: not to be quoted"""
    cramer_rao: Mapping[str, Any] | None = None
    """options of :func:`cramer_rao` that give its bound at any point, for the table of classical
    bounds at one common point; None: it is left out of that table"""
    full_label: str = ""
    """label without its neighbours in a figure, where ``label`` needs them"""
    against_others: str = ""
    """what sets its interval of tau apart from the others: "has no prior"; empty: not said"""

    def about(self) -> dict[str, Any]:
        """What figures and report say of the method, for ``bounds.json``: a report that is rebuilt
        later need not have the method registered, nor load what computes it."""
        return {
            "label": self.label,
            "full_label": self.full_label,
            "noise": self.noise,
            "needs_posterior": self.needs_posterior,
            "published_recipe": self.published_recipe,
            "against_others": self.against_others,
        }

    def __call__(self, evidence: Evidence) -> Bound:
        """The bound with the method's name, assumption and reference."""
        bound = self.compute(evidence)
        return replace(
            bound,
            method=self.name,
            assumes=self.assumes.replace("{noise}", evidence.noise_words) or bound.assumes,
            reference=self.reference or bound.reference,
        )
