"""Experiments to do next, and what to expect of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.design.tau_interval import Prediction
from bayes_sensor.display import record_card
from bayes_sensor.io.json_files import plain
from bayes_sensor.likelihood.noise import Noise, lag_coefficient
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.switching import is_switch_time

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Design:
    """Experiments to do next, and their expected result."""

    _repr_html_ = record_card

    experiments: pd.DataFrame
    """one row each: ``name``, ``total_flow_mL_s``, ``concentration``, ``duration_s``, ``on_s``,
    ``off_s``, ``interval_s``, ``beta_V`` (expected step)"""
    campaign: Campaign
    """the campaign with the proposals appended, all without data: ready for ``simulate``"""
    theta: FloatArray
    """flat vector for that campaign"""
    before: Prediction
    """with the existing experiments"""
    after: Prediction
    """with the proposals added"""
    target: float
    """s, wanted half width of the 95 % interval"""
    reached: bool
    status: str
    """one sentence"""
    prior: Prior
    """prior on tau in the prediction"""
    noise: Noise
    """law of the noise, one for all experiments"""

    @property
    def new_names(self) -> list[str]:
        """Names of the proposed experiments."""
        return [str(row["name"]) for row in self.experiments.to_dict("records")]

    @property
    def new(self) -> Campaign | None:
        """The proposed experiments alone; None if none are needed."""
        some = tuple(e for e in self.campaign if e.name in self.new_names)
        return (
            replace(self.campaign, title="proposed experiments", experiments=some) if some else None
        )

    @property
    def truth(self) -> dict[str, Any]:
        """The prediction's assumptions, for a simulation of :attr:`new` (of :attr:`campaign` if
        none is needed); see :meth:`truth_for`."""
        return self.truth_for(self.new or self.campaign)

    def truth_for(self, campaign: Campaign) -> dict[str, Any]:
        """The prediction's assumptions in the form that ``simulate --truth`` reads; every record's
        time starts at zero there.

        ``campaign``: some of the experiments of :attr:`campaign`.  sigma1 and phi refer to the
        highest concentration and to the most common interval of that campaign.  It has the
        parameters of every experiment.
        """
        shared, theta = self.campaign, self.theta.copy()
        i_phi, i_sigma0, i_sigma1 = Layout.of(shared).noise[0]
        if self.noise.by_concentration:
            of = campaign.reference_concentration / shared.reference_concentration
            theta[i_sigma1] = self.noise.referred(theta[i_sigma0], theta[i_sigma1], of)
        if campaign.reference_interval != shared.reference_interval:
            steps = campaign.reference_interval / shared.reference_interval
            theta[i_phi] = lag_coefficient(float(theta[i_phi]), steps)
        nested = Layout.of(shared).nested(theta)
        for e in self.campaign:
            own = nested["experiments"][e.name]
            for key in own:
                if is_switch_time(key) and not key.startswith("delay"):
                    own[key] -= float(e.t[0])
        return nested

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, units in the keys."""
        return {
            "target_half_width95_s": self.target,
            "reached": self.reached,
            "status": self.status,
            "before": plain(self.before.to_json()),
            "after": plain(self.after.to_json()),
            "experiments": self.experiments.to_dict("records"),
        }
