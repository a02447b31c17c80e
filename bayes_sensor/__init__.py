"""bayes_sensor: step-response parameters of a gas sensor with intervals under autocorrelated noise.

Names are loaded when first used, so that ``import bayes_sensor`` stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from bayes_sensor.compiled import give_compiled_code_a_place

give_compiled_code_a_place()  # before anything compiles

__version__ = "0.1.0"

_PUBLIC = {
    "Campaign": "campaign",
    "CampaignError": "campaign",
    "Experiment": "campaign",
    "SideInformation": "campaign",
    "progress_bar": "notebook",
    "read_campaign": "readers",
    "check_campaign": "check",
    "Cascade": "model",
    "Layout": "model",
    "cascade_response": "model",
    "euler_response": "model",
    "predict": "model",
    "Noise": "noise",
    "Prior": "likelihood",
    "Problem": "likelihood",
    "log_likelihood": "compression",
    "log_prior": "likelihood",
    "simulate": "likelihood",
    "compress": "compression",
    "Fit": "fit",
    "fit_least_squares": "fit",
    "Posterior": "posterior",
    "Settings": "posterior",
    "sample_posterior": "posterior",
    "diagnose_residuals": "residuals",
    "regress_delays": "delays",
    "compare_bounds": "bounds",
    "cramer_rao": "bounds",
    "explain_tau": "bounds",
    "design_experiments": "design",
    "what_if": "design",
    "step_study": "bounds",
    "Coating": "diffusion",
    "infer_d_zif8": "diffusion",
    "solve_diffusion": "diffusion",
    "Readout": "readout",
    "Ring": "readout",
    "response_times": "readout",
    "response_time_table": "readout",
    "check_predictive": "predictive",
    "diagnose_gap": "gap",
    "Gap": "gap",
    "own_effect": "gap",
    "run_fleet": "cli.fleet",
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
