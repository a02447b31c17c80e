"""A whole analysis by one call."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from operator import index
from pathlib import Path
from typing import Any

from bayes_sensor.analysis.analysis import Analysis
from bayes_sensor.analysis.job import Progress
from bayes_sensor.analysis.load_analysis import analysis_of
from bayes_sensor.analysis.overrides import Overrides, read_overrides
from bayes_sensor.analysis.run_steps import run_steps
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.display import progress_bar
from bayes_sensor.io.results import Results
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Settings

LARGEST_SEED = 2**32 - 1
BOOTSTRAP = 60
"""simulated campaigns behind the gap's p-values, as of :func:`diagnose_gap`"""


def analyze(
    campaign: str | os.PathLike[str] | Campaign | Problem,
    seed: int = 1,
    out: str | os.PathLike[str] | None = None,
    *,
    priors: Mapping[str, Any] | None = None,
    fix: Mapping[str, Any] | None = None,
    tie: Mapping[str, str] | None = None,
    noise: Mapping[str, Any] | None = None,
    sampler: str | None = None,
    settings: Settings | Mapping[str, Any] | None = None,
    config: str | os.PathLike[str] | None = None,
    without: Iterable[str] = (),
    effects: Any = (),
    nominal: Mapping[str, Any] | None = None,
    bootstrap: int = BOOTSTRAP,
    jobs: int = 1,
    resume: bool = False,
    quick: bool = False,
    progress: Callable[[str], Progress] | None = None,
) -> Analysis:
    """Fit, residuals, posterior, bounds, delays and gap of a campaign, as the command ``analyze``.

    Parameters
    ----------
    campaign
        its file ``campaign.toml``, a :class:`Campaign` (see :meth:`Campaign.from_frames`), or a
        :class:`Problem` of the chain of stages.
    seed
        the same seed gives the same numbers.
    out
        a folder for all results, with the report; None writes nothing.
    priors
        by parameter, such as ``{"V": "normal(60, 2) mL"}``: texts, :class:`Prior` objects or frozen
        laws of ``scipy.stats`` (``norm``, ``halfnorm``, ``lognorm``, ``uniform`` or
        ``loguniform``); objects are in s, mL and the signal's unit.
    fix
        parameters held at a value, such as ``{"tau_v": "0.86 s"}``; numbers are in s, mL and the
        signal's unit.
    tie
        lags and volumes that are another one or a multiple of it, such as
        ``{"tau[B]": "2 * tau[A]"}``.
    noise
        the noise law: ``variance``, ``autocorrelation``, ``per_experiment`` (:class:`Noise`).
    sampler, settings
        of the posterior (:func:`sample_posterior`, :class:`Settings`).
    config
        a file of settings, as ``--config``; what is given here wins over it.
    without, effects, nominal, bootstrap
        of the gap (:func:`diagnose_gap`).
    jobs
        processes; the numbers do not depend on it.
    resume
        go on with what an interrupted run left in ``out``.
    quick
        only fit, residuals and the posterior by a fast sampler; None where that cannot be trusted.
    progress
        called with the name of each step; what it returns is called with a fraction and a word.
        None draws a bar in a notebook.

    Returns
    -------
    Analysis
        With ``fit``, ``posterior``, ``bounds``, ``delays``, ``gap`` and ``residuals``.  The gap is
        None, with a sentence in ``notes``, where the records are too short for it.

    Raises
    ------
    CampaignError
        For input that cannot be used; nothing is then written.
    """
    if not hasattr(seed, "__index__") or not 0 <= seed <= LARGEST_SEED:
        raise CampaignError(f"seed: expected a whole number from 0, but got {seed!r:.40}")
    seed = index(seed)
    label = "analyze" if config is None else Path(config).name
    more = {"priors": priors, "fix": fix, "tie": tie, "noise": noise}
    overrides = read_overrides(
        None if config is None else Path(config),
        _sampling(sampler, settings),
        {name: table for name, table in more.items() if table is not None},
        "analyze",
    )
    given, overrides = _given(campaign, overrides, priors is not None or noise is not None)
    named = [without] if isinstance(without, str) else list(without)
    if effects and not isinstance(effects, Mapping):
        from bayes_sensor.diagnosis.effects.effect_model import listed

        effects = listed(effects, "analyze: effects")
    options: dict[str, Any] = {} if bootstrap == BOOTSTRAP else {"bootstrap": bootstrap}
    options |= {"without": tuple(named)} if named else {}
    options |= {"effects": effects} if effects else {}
    options |= {} if nominal is None else {"nominal": nominal}

    def bar(name: str) -> AbstractContextManager[Progress]:
        return nullcontext((progress or progress_bar)(name))

    job = run_steps(
        "analyze",
        given,
        overrides,
        label,
        None if out is None else Results(out),
        seed=seed,
        jobs=jobs,
        resume=resume,
        options=options,
        quick=quick,
        config=None if config is None else Path(config),
        bar=bar,
        command_line=("bayes_sensor.analyze",),
    )
    return analysis_of(job)


def _sampling(sampler: str | None, settings: Settings | Mapping[str, Any] | None) -> dict[str, Any]:
    """The sampler and its settings, by the names of the section [posterior]."""
    found = {} if sampler is None else {"sampler": sampler}
    if settings is None:
        return found
    return {**found, **(asdict(settings) if isinstance(settings, Settings) else dict(settings))}


def _given(campaign: Any, overrides: Overrides, told: bool) -> tuple[Path | Campaign, Overrides]:
    """The campaign or its path, and the settings with what a problem says."""
    if isinstance(campaign, Problem):
        if campaign.chain is None or told:
            raise CampaignError(
                "analyze: a Problem brings its own noise law and priors and is analysed with the "
                "chain of stages; expected one without another model, and no priors or noise "
                "beside it: give its campaign, or call fit_least_squares and sample_posterior"
            )
        if campaign.held:
            raise CampaignError(
                "analyze: the Problem has parameters that are held; expected them beside it: give "
                "its campaign, with fix, priors and noise"
            )
        law = type(overrides.noise)(**asdict(campaign.noise))
        own = {"noise": law, "priors": dict(campaign.given_priors)}
        return campaign.campaign, overrides.model_copy(update=own)
    if isinstance(campaign, Campaign):
        return campaign, overrides
    if isinstance(campaign, str | os.PathLike):
        return Path(campaign), overrides
    raise CampaignError(
        f"analyze: expected the path of a campaign.toml or a Campaign, but got a "
        f"{type(campaign).__name__}; make one with bs.Campaign.from_frames({{'1': data}}, "
        'total_flow="4.5 L/min", concentration="11.1 %", commanded_on="24 s")'
    )
