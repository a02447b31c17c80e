"""A proposal checked: posteriors of simulated campaigns against the predicted interval."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_sensor.design.proposal import Design
from bayes_sensor.design.record_information import EXACT
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import FASTEST, sample_posterior
from bayes_sensor.rig.layout import Layout


def check_design(
    design: Design,
    n: int,
    seed: int = 1,
    trigger: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Posterior intervals of ``n`` simulated campaigns of the proposal against the prediction.

    ``trigger``: sd (s) with which the new switch times are known; they then get normal priors about
    times drawn with that error.  Returns ``n``, ``mean_half_width95_s``, its ``sd_half_width95_s``
    between campaigns, ``predicted_half_width95_s``, their ``ratio``, ``within_20_percent`` and
    ``n_not_converged`` (left out of the mean).
    """
    names = design.new_names
    layout = Layout.of(design.campaign)
    widths, lost = [], 0
    for i, stream in enumerate(np.random.SeedSequence(seed).spawn(n)):
        data, sampling, timing = stream.spawn(3)
        plan = Problem(design.campaign, noise=design.noise)
        campaign = simulate(plan, design.theta, int(data.generate_state(1)[0]))
        priors = {"tau_s": design.prior}
        if trigger is not None:
            rng = np.random.default_rng(timing)
            for flat in layout.names:
                kind, _, rest = flat.partition("[")
                if kind in ("t0_s", "tf_s") and rest[:-1] in names:
                    sd = max(trigger, EXACT)
                    centre = design.theta[layout.index(flat)] + sd * rng.standard_normal()
                    priors[flat] = Prior("normal", float(centre), sd)
        posterior = sample_posterior(
            replace(plan, campaign=campaign, given_priors=priors),
            design.theta,
            int(sampling.generate_state(1)[0]),
            FASTEST,
        )
        if posterior.converged:
            low, high = posterior.quantiles("tau_s", [0.025, 0.975])
            widths.append(0.5 * (high - low))
        else:
            lost += 1
        if progress is not None:
            progress((i + 1) / n)
    mean = float(np.mean(widths)) if widths else np.nan
    ratio = mean / design.after.half_width95
    return {
        "n": n,
        "mean_half_width95_s": mean,
        "sd_half_width95_s": float(np.std(widths, ddof=1)) if len(widths) > 1 else np.nan,
        "predicted_half_width95_s": design.after.half_width95,
        "ratio": ratio,
        "within_20_percent": bool(abs(ratio - 1.0) <= 0.2),
        "n_not_converged": lost,
    }
