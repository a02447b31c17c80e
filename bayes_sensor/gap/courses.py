"""The courses that listed effects leave after a refit, as a screen.

Summed over all cells a misfit drowns in the noise of all of them; along the course of an effect
there is the noise of one number.  The largest of all courses, against what it is under noise alone
(max-T; Westfall and Young 1993), says whether anything of such a form is there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.gap.effect import Effect
from bayes_sensor.gap.refit import Part, Plan, Refit
from bayes_sensor.gap.where import Leverage
from bayes_sensor.gap.which import ABSORBED, joined_start, with_start

FAINT = 1e-3
"""standard deviations of the noise below which a course is none"""


def courses(base: Refit, catalogue: Mapping[str, Effect]) -> FloatArray:
    """(n, n_bins in all) whitened courses of unit length that the refit does not take up.

    One for each strength from which the fits of an effect begin, beside what the base has already;
    those that the refit takes up nearly whole are left out.
    """
    leverage, sketch = Leverage.of(base), base.plan.sketch
    here = base.plan.means(base.x)
    found = [np.zeros((0, len(base.residual)))]
    for effect in catalogue.values():
        for form in effect.forms if effect.on_mean else ():
            plan = Plan(sketch, (*base.plan.parts, Part(effect, form)))
            begun = joined_start(plan, base)
            for start in form.starts:
                moved = plan.means(with_start(plan, begun, start))
                course = sketch.whitened([b - a for a, b in zip(here, moved, strict=True)])
                left = leverage.leave(course[:, None])[:, 0]
                size = float(np.linalg.norm(left))
                if size > max(FAINT, ABSORBED**0.5 * float(np.linalg.norm(course))):
                    found.append(left[None, :] / size)
    return np.vstack(found)
