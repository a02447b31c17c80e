"""Why a verdict and the p-value of the excess disagree, where they do, in sentences."""

from __future__ import annotations

from bayes_sensor.diagnosis.location import CLEAR
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.verdict import OFTEN, Judgement
from bayes_sensor.display import shown


def against_p_value(judgement: Judgement, p: float, probabilities: Probabilities) -> list[str]:
    """Why verdict and p-value disagree, where they do."""
    kind, probability = judgement.kind, judgement.probability
    p_words = f"p = {shown(p, 2)}"
    if kind == "none":
        said = []
        unlisted = probabilities.unlisted
        if p > OFTEN and unlisted > probability:
            said.append(
                f"The evidence leans to a cause that is not listed ({percent(unlisted)}), but "
                f"noise alone often leaves as much as is left here ({p_words}), so that none is "
                "stated."
            )
        elif p < CLEAR:
            said.append(
                f"Noise alone would seldom leave as much ({p_words}), but no cause explains enough "
                "of it to be more probable than none."
            )
        return said
    if p <= CLEAR:
        return []
    catalogue = probabilities.catalogue
    if judgement.effects and not any(catalogue[n].on_mean for n in judgement.effects):
        return [f"It acts on single samples; their means show no more than noise ({p_words})."]
    if kind == "unlisted":
        return [
            f"The residual alone does not prove it: noise leaves as much in one of "
            f"{max(round(1.0 / p), 2)} campaigns ({p_words})."
        ]
    return [
        f"The residual alone shows no more than noise ({p_words}). The evidence for it is that "
        "the other parameters come closer to their plausible values."
    ]


def percent(probability: float) -> str:
    """A probability as sentences state it."""
    return f"{100.0 * probability:.0f} %"
