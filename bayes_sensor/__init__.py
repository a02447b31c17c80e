"""bayes_sensor: step-response parameters of a gas sensor with intervals under autocorrelated noise.

Names are loaded when first used, so that ``import bayes_sensor`` stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from bayes_sensor.compiled import ensure_numba_cache_dir

ensure_numba_cache_dir()  # before anything compiles

__version__ = "0.1.0"

_PUBLIC = {
    "Analysis": "analysis.analysis",
    "analyze": "analysis.analyze",
    "load": "analysis.load_analysis",
    "Campaign": "campaign",
    "CampaignError": "campaign",
    "Experiment": "campaign",
    "SideInformation": "campaign",
    "progress_bar": "display",
    "read_campaign": "io.readers",
    "check_campaign": "io.check",
    "Cascade": "rig.cascade",
    "Layout": "rig.layout",
    "cascade_response": "rig.cascade",
    "euler_response": "rig.cascade",
    "predict": "rig.cascade",
    "Noise": "likelihood.noise",
    "Prior": "likelihood.priors",
    "Problem": "likelihood.problem",
    "make_problem": "likelihood.problem_settings",
    "log_likelihood": "likelihood.mesh",
    "log_prior": "likelihood.prior_density",
    "simulate": "likelihood.density",
    "compress": "likelihood.mesh",
    "Fit": "fit",
    "fit_least_squares": "fit",
    "Posterior": "posterior",
    "Settings": "posterior",
    "sample_posterior": "posterior",
    "diagnose_residuals": "residuals",
    "regress_delays": "checks.delays",
    "compare_bounds": "bounds",
    "cramer_rao": "bounds",
    "explain_tau": "bounds",
    "design_experiments": "design",
    "what_if": "design",
    "step_study": "bounds",
    "Coating": "coating",
    "infer_d_zif8": "coating",
    "solve_diffusion": "coating",
    "Readout": "coating.readout",
    "Ring": "coating.readout",
    "response_times": "rig.response_times",
    "response_time_table": "rig.response_times",
    "check_predictive": "checks.predictive",
    "diagnose_gap": "diagnosis",
    "Gap": "diagnosis",
    "own_effect": "diagnosis",
    "restore": "restoration",
    "Restored": "restoration",
    "run_fleet": "cli.run_fleets",
}

# names that would say too little outside their room
_RENAMED = {"solve_diffusion": "solve"}

__all__ = ["__version__", *sorted(_PUBLIC)]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'bayes_sensor' has no attribute '{name}'")
    value = getattr(import_module(f"bayes_sensor.{_PUBLIC[name]}"), _RENAMED.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
