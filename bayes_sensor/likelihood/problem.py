"""A campaign with its model, noise law and priors: what is fitted and sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import (
    Campaign,
    CampaignError,
    Experiment,
    FloatArray,
    not_a_campaign,
)
from bayes_sensor.display import record_card
from bayes_sensor.likelihood.default_priors import default_priors
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.priors import KINDS, Prior
from bayes_sensor.rig.cascade import Cascade, has_own_mean, method_of_chain
from bayes_sensor.rig.lags import Assignment, Commuting, Naming, assignments
from bayes_sensor.rig.layout import NOISE, Layout, Theta, check_name


@dataclass(frozen=True, eq=False)
class Problem:
    """A campaign with the model, the noise law and the priors that explain it.

    Effects return a changed Problem: another ``model`` (with ``extra`` parameters), another
    ``noise``, further ``priors``; nothing else needs to know.

    A model is any object with ``extra`` (names of its own parameters, units included),
    ``response(t, theta, layout, experiment)`` and ``mean(..)`` (n_t,), smooth in ``t`` between the
    switch times.  It may further have

    * ``mean_and_response(t, theta, layout, experiment)``, both at the price of one,
    * ``affine``: True where the mean is y0 + beta times something plus something, both of them
      and the response free of y0 and beta (taken for granted where the mean is the cascade's),
    * ``kinks(low, high, layout, experiment)``: stretches (start, end) in s, for theta between
      ``low`` and ``high`` (n_theta,), in which the mean or the response may jump or bend other
      than at the switches.
    """

    _repr_html_ = record_card

    campaign: Campaign
    model: Cascade = field(default_factory=Cascade)
    noise: Noise = field(default_factory=Noise)
    given_priors: Mapping[str, Prior] = field(default_factory=dict)
    """priors that replace the default ones, by flat name; one for ``phi``, ``sigma0_V`` or
    ``sigma1_V`` also serves every experiment that has its own, and those of experiments that are
    not in the campaign wait"""
    held: Mapping[str, float] = field(default_factory=dict)
    """parameters of the mean that have a value and are neither fitted nor sampled, by flat name of
    their place in theta (:func:`bayes_sensor.likelihood.held_values.held_values`)"""

    @cached_property
    def chain(self) -> str | None:
        """How the response of the rig's chain is computed, ``exact`` or ``euler``; None where the
        model is another one than the chain alone."""
        return method_of_chain(self.model)

    @cached_property
    def has_plain_mean(self) -> bool:
        """Whether the mean is y0 + beta x with x the model's response."""
        return not (has_own_mean(self.model) or hasattr(self.model, "mean_and_response"))

    @cached_property
    def is_affine(self) -> bool:
        """Whether the mean is y0 + beta a(t) + b(t) with a, b and the response free of both."""
        return bool(getattr(self.model, "affine", not has_own_mean(self.model)))

    @cached_property
    def layout(self) -> Layout:
        """Order of the flat vector."""
        return Layout.of(self.campaign, self.noise.per_experiment, self.model.extra)

    @cached_property
    def named_laws(self) -> dict[str, Prior]:
        """What is known of shared parameters by name: side information, or a given prior.

        Raises CampaignError where two of parameters that are tied have side information.
        """
        known: dict[str, Prior] = {}
        shared, sources = self.layout.shared_names, self.layout.sources
        for name, info in self.campaign.side_information.items():
            if name not in sources:
                continue
            source, factor = sources[name]
            if source in known:
                raise CampaignError(
                    f"side information on {name}: what it is tied to has side information as well; "
                    "expected one of them: remove the other"
                )
            known[source] = Prior("normal", info.mean / factor, info.sd / factor)
        return {name: law for name, law in {**known, **self.given_priors}.items() if name in shared}

    @cached_property
    def commuting(self) -> Commuting:
        """The lags that the data know as a set, and their places in theta."""
        return Commuting.of(self.campaign, self.layout)

    @cached_property
    def assignments(self) -> tuple[Assignment, ...]:
        """The ways in which the campaign's lags may be named, all of one prior probability."""
        known = [name for name in self.named_laws if name.startswith("V_")]
        return assignments(self.campaign.sensor_is, self.commuting.names, known)

    @property
    def flow(self) -> float | None:
        """mL/s, the total flow where all experiments share one and volumes are among the lags that
        commute, else None."""
        return self.commuting.flow

    @cached_property
    def priors(self) -> dict[str, Prior]:
        """The prior law of every place in theta, by flat name.

        Lags stand in theta by size (see :func:`default_priors`).  What is known by name replaces
        the law of its place where all possible assignments of names agree on that; where they do
        not it weighs them (:attr:`name_factors`), and the laws of the places stay as they are.

        Raises CampaignError where one is given for a name that no parameter has.
        """
        faster = self.campaign.sensor_is == "faster" and self._settled.get("tau_s") == 0
        usual = default_priors(self.campaign, self.layout, self.commuting, faster)
        return {**usual, **self.given_laws}

    def check_prior(self, name: str, law: Prior, where: str) -> None:
        """Raise CampaignError where a prior allows no value that the parameter ``name`` can have.

        Lags, volumes and sizes of noise are positive; phi lies between -1 and 1, and above 0 where
        sampling intervals differ.  Parameters of the signal and of a model's own have any value.
        """
        kind = name.split("[")[0]
        if kind == "phi":
            law.check_within(-1.0 if self.campaign.same_interval else 0.0, 1.0, where)
        elif kind in NOISE or name in (*self.layout.shared_names, *self.layout.value_names):
            law.check_within(0.0, np.inf, where)

    @cached_property
    def given_laws(self) -> dict[str, Prior]:
        """Those of :attr:`priors` that the user gave, side information included."""
        shared = self.layout.shared_names
        # not when it is made: a problem may be on its way to another model, with its parameters
        for name, law in self.given_priors.items():
            check_name(self.layout, name, "Problem.given_priors")
            self.check_prior(name, law, f"Problem.given_priors: {name}")
        for name in self.held:
            check_name(self.layout, name, "Problem.held")
        given = {name: law for name, law in self.given_priors.items() if name not in shared}
        for name in self.layout.noise_names:
            kind = name.split("[")[0]
            if kind in given:
                given.setdefault(name, given[kind])
        settled = self._settled
        for name, law in self.named_laws.items():
            if name in settled:
                given[shared[settled[name]]] = law
        return given

    @cached_property
    def _settled(self) -> dict[str, int]:
        """Place in theta of every shared parameter that is in the same one in all assignments."""
        commuting, found = self.commuting, {}
        for position, name in enumerate(self.layout.shared_names):
            places = {choice.place(name) for choice in self.assignments}
            if len(places) == 1:
                (place,) = places
                found[name] = position if place is None else commuting.places[place]
        return found

    @cached_property
    def lag_priors(self) -> tuple[Prior, ...]:
        """The prior law of every lag (s) that the flows do not tell apart, shortest first."""
        commuting, found = self.commuting, []
        for place, volume in zip(commuting.places, commuting.volumes, strict=True):
            law = self.priors[self.layout.shared_names[place]]
            scaled = volume and commuting.flow is not None
            found.append(law.scaled(1.0 / commuting.flow) if scaled and commuting.flow else law)
        return tuple(found)

    def prior_of_tau(self, theta: FloatArray) -> Prior:
        """The prior law of the sensor's lag at ``theta`` (n_theta,), which is by name: what is
        known of it, or the law of its place among the lags."""
        if "tau_s" in self.named_laws:
            return self.named_laws["tau_s"]
        place = self.naming().place("sensor")
        if place is None:
            lags = self.commuting.lags(self.commuting.by_size(theta))
            place = int(np.argmin(np.abs(lags - theta[self.layout.tau])))
        return self.lag_priors[place]

    @cached_property
    def name_factors(self) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray]:
        """What is known by name and weighs the assignments, as factors of the prior.

        The law of factor ``j`` under assignment ``a`` is ``KINDS[kind[j]]`` with ``numbers[j]``, at
        ``theta[place[a, j]] * scale[a, j]``: place (n_assignments, n_factors), kind (n_factors,),
        numbers (n_factors, 2), scale (n_assignments, n_factors).  The prior is the mean over the
        assignments of their products, on top of the uniform law that all lags have.
        """
        commuting = self.commuting
        names = [
            name
            for name, law in self.named_laws.items()
            if name not in self._settled and law.kind != "flat"
        ]
        shape = (len(self.assignments), len(names))
        place, scale = np.zeros(shape, dtype=np.int64), np.ones(shape)
        for a, assignment in enumerate(self.assignments):
            for j, name in enumerate(names):
                lag = assignment.place(name)
                assert lag is not None  # what does not commute is settled
                place[a, j] = commuting.places[lag]
                scale[a, j] = commuting.to_lag[lag]
                if name.startswith("V_") and commuting.flow is not None:
                    scale[a, j] *= commuting.flow
        laws = [self.named_laws[name] for name in names]
        kind = np.array([KINDS.index(law.kind) for law in laws], dtype=np.int64)
        return place, kind, np.array([(law.a, law.b) for law in laws]).reshape(-1, 2), scale

    def log_weights(self, thetas: FloatArray) -> FloatArray:
        """(.., n_assignments) log of what is known by name under every assignment, at ``thetas``
        (.., n_theta) that hold lags by size."""
        place, kind, numbers, scale = self.name_factors
        total = np.zeros((*thetas.shape[:-1], len(self.assignments)))
        for j in range(len(kind)):
            law = Prior(KINDS[kind[j]], *numbers[j])
            total += law.log_density(thetas[..., place[:, j]] * scale[:, j])
        return total

    def naming(self, probabilities: FloatArray | None = None) -> Naming:
        """What may be said of the lags' names.

        ``probabilities`` (n_assignments,) of the assignments: default equal.
        """
        n = len(self.assignments)
        shares = np.full(n, 1.0 / n) if probabilities is None else probabilities
        return Naming(
            self.campaign.sensor_is, self.assignments, tuple(map(float, shares)), self.commuting
        )

    def shares(self, thetas: FloatArray) -> FloatArray:
        """(.., n_assignments) probability of every assignment at ``thetas`` (.., n_theta)."""
        weights = self.log_weights(thetas)
        found: FloatArray = np.exp(weights - np.logaddexp.reduce(weights, axis=-1)[..., None])
        return found

    def by_size(self, theta: Theta) -> FloatArray:
        """:meth:`flat` with the lags in the places that they have by size.

        Where the campaign says that the sensor is the faster lag, ``theta`` is taken to mean that.
        """
        vector = self.flat(theta)
        if self.flow is None and self.campaign.sensor_is == "faster":
            return vector
        return self.commuting.by_size(vector)

    def by_name(self, theta: Theta) -> FloatArray:
        """:meth:`flat` with the shared parameters by name in their places.

        A mapping says which lag is which.  A flat vector may come from a fit or a posterior, with
        lags by size: then the campaign has to say it.

        Raises CampaignError where neither does.
        """
        vector = self.flat(theta)
        if isinstance(theta, Mapping) or self.campaign.sensor_is == "faster":
            return vector
        if self.naming().order == "undecided":
            raise CampaignError(
                f"{self.campaign.source or self.campaign.title}: expected to be told which lag is "
                "the sensor's, but [rig] sensor_is is unknown and theta has no names; say "
                'sensor_is = "faster" or "slower" in the campaign, or give theta as a mapping'
            )
        ordered = self.commuting.by_size(vector)
        vector[: self.layout.n_shared] = self.commuting.named(ordered, self.assignments)
        return vector

    @cached_property
    def fixed(self) -> dict[str, float]:
        """Flat names that do not vary, with their values: what the noise law pins, and what is
        held."""
        pinned = self.noise.fixed
        found = {
            name: pinned[name.split("[")[0]]
            for name in self.layout.noise_names
            if name.split("[")[0] in pinned
        }
        return {**found, **self.held}

    def place_of(self, name: str) -> str | None:
        """Flat name of the place in theta of a parameter; None for a lag that has one only where
        its name is settled, and it is not."""
        shared = self.layout.shared_names
        if name not in shared:
            return name if name in self.layout.names else None
        return shared[self._settled[name]] if name in self._settled else None

    def flat(self, theta: Theta) -> FloatArray:
        """The flat vector (n_theta,) of ``theta``, a new one, under this problem's noise law.

        What the law pins (:attr:`fixed`) has its pinned value whatever ``theta`` says, as in a fit
        or a posterior of this problem: a ``theta`` made under another law can be used.

        Raises CampaignError as :meth:`Layout.flat`.
        """
        vector = self.layout.flat(theta)
        for name, value in self.fixed.items():
            vector[self.layout.index(name)] = value
        return vector

    @cached_property
    def prior_table(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Place of each law in ``KINDS`` (n_theta,), its numbers (n_theta, 2); pinned: flat.

        Raises CampaignError where a parameter of the model has no prior.
        """
        missing = [name for name in self.layout.extra if name not in self.priors]
        if missing:
            raise CampaignError(
                f"the model's parameter '{missing[0]}' has no prior; give one in "
                f"Problem.given_priors, such as {{'{missing[0]}': Prior('normal', 0.0, 1.0)}}"
            )
        table = np.zeros((len(self.layout), 2))
        kinds = np.full(len(self.layout), KINDS.index("flat"))
        for i, name in enumerate(self.layout.names):
            if name not in self.fixed:
                prior = self.priors[name]
                kinds[i], table[i] = KINDS.index(prior.kind), (prior.a, prior.b)
        return kinds, table

    def steps(self, experiment: Experiment) -> float:
        """The experiment's sampling interval in reference intervals."""
        return experiment.interval / self.campaign.reference_interval


def as_problem(campaign: Campaign | Problem) -> Problem:
    """A Problem with the default model and noise where a campaign is given.

    Raises CampaignError for anything else.
    """
    if isinstance(campaign, Campaign):
        return Problem(campaign)
    if not isinstance(campaign, Problem):
        raise not_a_campaign(campaign, "a Campaign or a Problem")
    return campaign
