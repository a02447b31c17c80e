"""What the catalogue can make of a cause: the share of its noise-free misfit each effect closes.

The diagnosis's own refits are used, on bins without noise: an effect that closes nearly all of the
misfit is a look-alike, and naming it, or no name, cannot be held against the diagnosis.  The right
effect, too, may leave something, since the simulator's causes differ in form from the effects.
"""

from __future__ import annotations

from dataclasses import replace

from bayes_sensor.blind_check.simulator import Case, as_recorded, clean_signals, make_campaign
from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.evidence.coordinate_priors import Part
from bayes_sensor.diagnosis.evidence.hypotheses import fit_effect
from bayes_sensor.rig.layout import Layout
from bayes_sensor.workers import one_thread


@one_thread
def closed_shares(case: Case) -> dict[str, float]:
    """1 - d_effect^2/d^2 for every effect of the catalogue that acts on the mean.

    Empty where the diagnosis refuses the campaign or there is no misfit, and on other rigs than the
    published one, where no verdict is excused by a look-alike.
    """
    if not case.is_published:
        return {}
    campaign = make_campaign(case)
    steps = as_recorded(case).steps
    theta = {
        "tau_s": case.tau, "tau_v_s": case.tau_v, "V_mL": case.V,
        "experiments": {
            s.name: {"y0_V": s.y0, "beta_V": s.beta, "t0_s": s.t0, "tf_s": s.tf} for s in steps
        },
    }  # fmt: skip
    try:
        binned = prepare(campaign, Layout.of(campaign).flat(theta)).binned
    except CampaignError:  # no quiet stretch
        return {}
    clean = clean_signals(case)
    means = (bins.average(clean[e.name]) for e, bins in zip(campaign, binned.bins, strict=True))
    binned = replace(binned, data=tuple(means))
    base = fit_base(binned)
    if base.misfit < 1e-6:
        return {}
    shares = {}
    for name, effect in CATALOGUE.items():
        if effect.on_mean:
            parts = [Part(effect, form) for form in effect.forms]
            fits = [fit_effect(binned, base, [part], part.form.starts) for part in parts]
            left = min(fit.loosened.misfit for fit in fits)
            shares[name] = max(0.0, 1.0 - left / base.misfit)
    return shares
