"""Weakly informative priors for every parameter, from the records themselves."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.rise_time import fastest_rise, longest_watch, published_rise_time
from bayes_sensor.likelihood.switch_ranges import switch_ranges
from bayes_sensor.rig.lags import Commuting
from bayes_sensor.rig.layout import Layout

# Scale of the half-normal prior on tau at the published rig, and the time its fastest experiment
# (9 L/min) takes from 10 to 90 %; another rig's scale follows in proportion.
TAU_PRIOR_SCALE = 0.200

LONGEST = 10.0
"""times that a record was watched, up to which a lag of unknown name is looked for"""


def default_priors(
    campaign: Campaign,
    layout: Layout,
    commuting: Commuting | None = None,
    shortest_is_tau: bool | None = None,
) -> dict[str, Prior]:
    """Weakly informative priors for every parameter of a campaign, by flat name.

    theta holds lags by size (:mod:`bayes_sensor.rig.lags`): ``tau_s`` is the name of the shortest
    lag's place here and, for the published rig, ``tau_v_s`` of the longest's and, at one flow,
    ``V_mL`` of the middle one's.

    * Where the sensor is said to be the faster of several lags, as in the paper, the shortest lag
      is half-normal, 200 ms at the published rig and in proportion to the fastest rise seen
      elsewhere (rounded to one digit, so that noise does not move it); the information is on
      tau^2, so this choice matters near zero; see the prior table in the report.  If one other lag
      is left, it is log-normal around a third of the fastest rise, sd 1.5 in the logarithm.
    * All other lags that may be exchanged have one law, so that no prior decides which is which:
      uniform up to ten times the longest time from a first command to the end of its record.
      What the records do not bound above is said to be so, because that end then decides.
    * Volumes, where flows tell them: log-normal around the volume that flow would fill in a third
      of the rise, sd 1.5.
    * Switch times: uniform from the commanded time (nothing happens before the command) to the next
      command or the record's end; without commanded times uniform over the record.  A delay that
      several switches share: uniform up to the shortest time between two commands.
    * ``y0``, ``beta``: flat (the data hold them to a thousandth; flat makes the marginal exact).
    * ``phi``: uniform on (-1, 1), or (0, 1) when sampling intervals differ.
    * ``sigma0``, ``sigma1``: half-normal, ten times the campaign's sample-to-sample scatter.

    Side information and priors that the user gives come on top (:attr:`Problem.priors`).
    ``shortest_is_tau``: whether the shortest lag is the sensor's for sure; default as the campaign
    says.
    """
    commuting = commuting or Commuting.of(campaign, layout)
    if shortest_is_tau is None:
        shortest_is_tau = campaign.sensor_is == "faster"
    rise = fastest_rise(campaign)
    scale = TAU_PRIOR_SCALE * rise / published_rise_time()
    scale = float(f"{scale:.0e}")
    most = LONGEST * longest_watch(campaign)
    flow = float(np.median([e.total_flow for e in campaign]))
    measured = [e for e in campaign if e.y is not None]
    scatter = max((max(_scatter(e), e.rounding) for e in measured), default=1e-9)
    priors: dict[str, Prior] = {}
    for name in layout.shared_names:
        if name.startswith("V_"):
            priors[name] = Prior("log_normal", flow * rise / 3.0, 1.5)
        else:
            priors[name] = Prior("uniform", 0.0, most)
    lags = [layout.shared_names[place] for place in commuting.places]
    shortest = lags[:1] if shortest_is_tau and len(layout.shared_names) > 1 else []
    exchanged = [name for name in lags if name not in shortest]
    for name in shortest:
        priors[name] = Prior("half_normal", scale)
    for name in exchanged:
        if len(exchanged) == 1 and shortest and not name.startswith("V_"):
            priors[name] = Prior("log_normal", rise / 3.0, 1.5)
        elif name.startswith("V_"):
            priors[name] = Prior("uniform", 0.0, most * flow)
    for e, switching, record in zip(campaign, layout.switching, layout.records, strict=True):
        priors[f"y0_V[{e.name}]"] = Prior("flat")
        priors[f"beta_V[{e.name}]"] = Prior("flat")
        for kind, (low, high) in zip(switching.names, switch_ranges(e), strict=True):
            priors[f"{kind}[{record}]"] = Prior("uniform", low, high)
    for name in layout.noise_names:
        kind = name.split("[")[0]
        if kind == "phi":
            priors[name] = Prior("uniform", -1.0 if campaign.same_interval else 0.0, 1.0)
        else:
            priors[name] = Prior("half_normal", 10.0 * scatter)
    return priors


def _scatter(e: Experiment) -> float:
    y = e.values[e.used]
    return float(np.std(y[: max(10, len(y) // 10)])) + float(np.std(np.diff(y)))
