"""What decides whether the headline of a fit stands, as sentences that every command repeats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.misfit import Misfit, warning
from bayes_sensor.fit.side_information import Comparison
from bayes_sensor.likelihood import Problem


def caveats(
    problem: Problem,
    vector: FloatArray,
    residuals: list[tuple[FloatArray, FloatArray]],
    misfit: Mapping[str, Misfit],
    compared: Sequence[Comparison] = (),
) -> list[str]:
    """Sentences that belong before the headline; empty where it stands as it is.

    ``vector`` (n_theta,): the fit; ``residuals``: of every experiment r (n_t,) in V and x3 (n_t,);
    ``misfit``: of every experiment by name; ``compared``: side information beside what the data
    alone say.
    """
    found = [warning(misfit, problem.campaign.signal_unit)]
    found += [each.sentence() for each in compared if each.contradicts]
    return [text for text in found if text]
