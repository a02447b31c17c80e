"""The bound methods, one per file, and the registry that names them.

A method of your own is a :class:`BoundMethod`; ``METHODS[METHOD.name] = METHOD`` puts it beside
the others in ``bounds.json``, the figures, the report and the coverage study.
"""

from __future__ import annotations

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.methods import (
    block_bootstrap,
    crlb_ar1,
    crlb_iid,
    crlb_iid_one_percent_step,
    jackknife_experiments,
    posterior_quantiles,
    profile_likelihood,
    sandwich,
    sandwich_ar1,
)
from bayes_sensor.bounds.methods.bound_method import BoundMethod

__all__ = [
    "COLOURED",
    "METHODS",
    "PUBLISHED",
    "ROLES",
    "TO_QUOTE",
    "WHITE",
    "BoundMethod",
    "method_of",
]

METHODS: dict[str, BoundMethod] = {
    module.METHOD.name: module.METHOD
    for module in (
        crlb_iid,
        crlb_iid_one_percent_step,
        crlb_ar1,
        sandwich,
        sandwich_ar1,
        block_bootstrap,
        jackknife_experiments,
        profile_likelihood,
        posterior_quantiles,
    )
}
"""every method by name, in the order in which they are computed and shown"""

TO_QUOTE = tuple(module.METHOD.name for module in (profile_likelihood, sandwich, crlb_ar1))
"""whose interval to state where there is no posterior: the first that was computed"""
WHITE = crlb_iid.METHOD.name
"""the Cramer-Rao bound as a textbook has it; the report compares it with the next two in words"""
PUBLISHED = crlb_iid_one_percent_step.METHOD.name
COLOURED = crlb_ar1.METHOD.name
ROLES = {"white": WHITE, "published": PUBLISHED, "coloured": COLOURED, "to_quote": list(TO_QUOTE)}
"""the same for ``bounds.json``"""


def method_of(name: str) -> BoundMethod:
    """The record of a method; for one that is not registered here, its name as label."""
    return METHODS.get(name) or BoundMethod(name, name, "", _unregistered)


def _unregistered(evidence: Evidence) -> Bound:
    raise LookupError("this method is not registered, so it cannot be computed")
