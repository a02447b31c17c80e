"""Signatures: what listed effects leave after a refit, as a screen.

Summed over all cells a small misfit is lost in the noise of all; along the signature of an effect
there is the noise of one number.  The largest of all, against what it is under noise alone
(max-T; Westfall and Young 1993), says whether anything of such a form is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.coordinate_priors import Part
from bayes_sensor.diagnosis.evidence.hypotheses import ABSORBED
from bayes_sensor.diagnosis.evidence.refit import Refit

FAINT = 1e-3
"""standard deviations of the noise below which a signature is none"""


def signatures(base: Refit, catalogue: Mapping[str, Effect]) -> FloatArray:
    """(n, n_bins in all) whitened signatures of unit length that the refit does not take up.

    One for each strength from which the fits of an effect begin, beside what the base has already,
    and one for each experiment alone, at a plausible strength, where an effect has another in each;
    those that the refit takes up nearly whole are left out.
    """
    leverage, binned = base.leverage, base.coords.binned
    here = base.coords.all_means(base.x)
    found = [np.zeros((0, binned.n_bins))]

    def add(whole: FloatArray) -> None:
        left = leverage.leave(whole.T).T
        size = np.linalg.norm(left, axis=1)
        seen = size > np.maximum(FAINT, ABSORBED**0.5 * np.linalg.norm(whole, axis=1))
        found.append(left[seen] / size[seen, None])

    for effect in catalogue.values():
        for form in effect.forms if effect.on_mean else ():
            coords = replace(base.coords, parts=(*base.coords.parts, Part(effect, form)))
            begun = coords.start_from(base.coords, base.x)

            from_start = partial(coords.signature, begun, here)
            add(np.array([from_start(start) for start in form.starts]))
            own = {s.name: s.value(1.0) for s in coords.strengths[-1] if s.per_experiment}
            if own:
                each = np.zeros((len(binned.rows), binned.n_bins))
                unlike = from_start({**form.starts[0], **own})
                for alone, rows in zip(each, binned.rows, strict=True):
                    alone[rows] = unlike[rows]
                add(each)
    return np.vstack(found)
