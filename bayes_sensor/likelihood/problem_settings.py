"""A problem from what a user says of priors, held parameters and noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_sensor.campaign import Campaign, not_a_campaign
from bayes_sensor.io.given_options import record_of
from bayes_sensor.likelihood.held_values import held_values, key_of
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.prior_text import read_priors
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.ties import tie_parameters, tie_texts


def make_problem(
    campaign: Campaign,
    priors: Mapping[str, Any] | None = None,
    fix: Mapping[str, str | float] | None = None,
    noise: Noise | Mapping[str, Any] | None = None,
    label: str = "make_problem",
    tie: Mapping[str, str] | None = None,
) -> Problem:
    """A campaign with priors, held parameters and a noise law of one's own.

    Parameters
    ----------
    priors
        by name (``tau``, ``V``, ``t0`` for all experiments, ``t0[4]`` for one): texts such as
        ``"normal(60, 2) mL"``, :class:`Prior` objects, or frozen laws of ``scipy.stats`` (``norm``,
        ``halfnorm``, ``lognorm``, ``uniform`` or ``loguniform``; of others than ``norm`` and
        ``uniform`` with ``loc`` 0); objects are in s, mL and the signal's unit.
    fix
        parameters held at a value: texts such as ``"0.86 s"``, or numbers in s and mL.  They are
        neither fitted nor sampled; bounds, delays and gap do not carry them.
    noise
        a :class:`Noise`, or its options.
    label
        what messages call the settings.
    tie
        lags and volumes that are another one or a multiple of it, such as
        ``{"tau[B]": "2 * tau[A]"}``, in addition to the campaign's own (``Campaign.ties``).

    Raises
    ------
    CampaignError
        For an unknown name, what is no prior or no value, a prior that allows no value which the
        parameter can have, or ties that make no sense.

    Examples
    --------
    >>> from bayes_sensor import Campaign, Experiment, make_problem
    >>> import numpy as np
    >>> t = np.arange(0.0, 20.0, 0.01)
    >>> e = Experiment("1", t, np.zeros(len(t)), 60.0, 10.0, 0.01, commanded_on=5.0)
    >>> problem = make_problem(Campaign("one", (e,)), {"V": "normal(60, 2) mL"})
    >>> problem.given_priors
    {'V_mL': Prior(kind='normal', a=60.0, b=2.0)}
    """
    if not isinstance(campaign, Campaign):
        raise not_a_campaign(campaign)
    law = record_of(Noise, noise, f"{label}: noise")
    if tie:
        texts = {**tie_texts(campaign.ties), **tie}
        campaign = tie_parameters(campaign, texts, f"{label}: [tie]")
    bare = Problem(campaign, noise=law)
    unit = campaign.signal_unit
    given = read_priors(priors or {}, bare.layout, unit, f"{label}: [priors]")
    for name, prior in given.items():
        bare.check_prior(name, prior, f"{label}: [priors] {key_of(name)}")
    problem = Problem(campaign, noise=law, given_priors=given)
    return held_values(problem, fix, f"{label}: [fix]") if fix else problem
