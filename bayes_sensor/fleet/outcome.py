"""The result of one campaign in the comparison: a row of numbers, or the reason for a failure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_sensor.io.results import Results

SHARED = (("tau", "s"), ("tau_v", "s"), ("V", "mL"))
PERCENTILES = {
    "": "q50", "_lo95": "q2.5", "_hi95": "q97.5", "_lo68": "q16", "_hi68": "q84",
}  # fmt: skip
DONE, NOT_CONVERGED, FAILED = "done", "not converged", "failed"
COLUMNS = (
    "campaign", "file", "title", "status", "message", "experiments", "samples", "signal_unit",
    *(f"{name}{end}_{unit}" for name, unit in SHARED for end in (*PERCENTILES, "_sd")),
    "tau_upper95_s", "tau_is_limit", "phi", "sigma0_V", "sigma1_V", "rms_V", "crlb_iid_tau_sd_s",
    "least_ess", "largest_r_hat", "gap", "gap_effects", "gap_probability",
    "tau_envelope_lo_s", "tau_envelope_hi_s", "report", "order", "lag_fast_s", "lag_slow_s",
    "tau_with_cause_s", "tau_with_cause_lo95_s", "tau_with_cause_hi95_s",
)  # fmt: skip
"""of the table: medians of the posterior, equal-tailed limits, ``_V`` in the campaign's own unit;
``tau_with_cause``: with the cause of a misfit in the model, where the diagnosis found one that the
posterior lacks (the headline of the campaign's report)"""


def row_of(results: Results, name: str, file: str, report: str, message: str) -> dict[str, Any]:
    """The row of an analysed campaign, from its results folder.

    ``tau_is_limit``: zero is not excluded, so only ``tau_upper95_s`` is stated.  If it is not known
    which lag is the sensor's (``order`` undecided), tau and tau_v have no values, and at one flow V
    has none.
    """
    from bayes_sensor.figures.method_words import classical_bound
    from bayes_sensor.report import headline  # draws, so slow to import
    from bayes_sensor.report.cause_left_out import left_out

    campaign, fit, posterior, bounds, gap = (
        results.json(f"{part}.json") for part in ("campaign", "fit", "posterior", "bounds", "gap")
    )
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row.update(
        campaign=name,
        file=file,
        title=campaign["title"],
        status=DONE if posterior["converged"] and fit["converged"] else NOT_CONVERGED,
        message=message,
        experiments=len(campaign["experiments"]),
        samples=campaign["n_samples"],
        signal_unit=campaign["signal_unit"],
        rms_V=fit["rms_V"],
        report=report,
    )
    parameters = posterior["parameters"]
    row["order"] = order = posterior.get("order", "given")
    if lags := posterior.get("lags_s"):
        row["lag_fast_s"], row["lag_slow_s"] = lags[0]["q50"], lags[-1]["q50"]
    for symbol, unit in SHARED:
        if order == "undecided" and (symbol != "V" or campaign["same_flow"]):
            continue
        own = parameters.get(f"{symbol}_{unit}")
        if own is None:  # another rig
            continue
        for end, percentile in PERCENTILES.items():
            row[f"{symbol}{end}_{unit}"] = own[percentile]
        row[f"{symbol}_sd_{unit}"] = own["sd"]
    for noise in ("phi", "sigma0_V", "sigma1_V"):
        if noise in parameters:
            row[noise] = parameters[noise]["q50"]
    row["least_ess"] = _least(p["ess_bulk"] for p in parameters.values())
    row["largest_r_hat"] = _largest(p["r_hat"] for p in parameters.values())
    head = headline(posterior, bounds, gap=gap)
    if order != "undecided":
        row["tau_is_limit"] = bool(head is not None and head.is_limit)
    for prior in posterior.get("tau_under_priors") or []:
        if order != "undecided" and prior["prior"] == "half_normal":
            row["tau_upper95_s"] = prior["upper95_s"]
    row["crlb_iid_tau_sd_s"] = classical_bound(bounds, "white").get("tau_s")
    if gap is not None:
        verdict = gap["verdict"]
        row["gap"], row["gap_probability"] = verdict["kind"], verdict["probability"]
        row["gap_effects"] = " ".join(verdict["effects"])
        envelope = gap["hidden"].get("tau_envelope_s") or (None, None)
        cause = left_out(gap, posterior) if head is not None and head.without else None
        if order != "undecided":
            row["tau_envelope_lo_s"], row["tau_envelope_hi_s"] = envelope
            if cause is not None:
                row["tau_with_cause_lo95_s"], row["tau_with_cause_s"] = cause.ends_s[:2]
                row["tau_with_cause_hi95_s"] = cause.ends_s[2]
    return row


def failed_row(name: str, file: str, message: str) -> dict[str, Any]:
    """The row of a campaign without results."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row.update(campaign=name, file=file, status=FAILED, message=" ".join(message.split()))
    return row


def _least(values: Any) -> float | None:
    return min((v for v in values if v is not None), default=None)


def _largest(values: Any) -> float | None:
    return max((v for v in values if v is not None), default=None)


def fingerprint(campaign_file: Path) -> dict[str, str]:
    """SHA-256 of a campaign's file and of its data files, by path relative to its folder."""
    from bayes_sensor.io.json_files import sha256
    from bayes_sensor.io.readers import LARGEST_FILE, read_bytes
    from bayes_sensor.io.toml_text import read_toml

    content = read_bytes(campaign_file, str(campaign_file), LARGEST_FILE, "a campaign file in TOML")
    tables = read_toml(content, campaign_file.name)
    names = [campaign_file.name, *(entry["file"] for entry in tables["experiment"])]
    places = {name: campaign_file.parent / name for name in names}
    return {name: sha256(place) for name, place in places.items() if place.is_file()}


def unchanged(campaign_file: Path, known: Mapping[str, str]) -> bool:
    """Whether its files are those of an earlier :func:`fingerprint`."""
    try:
        return fingerprint(campaign_file) == known
    except (OSError, ValueError, KeyError, TypeError):  # told when it is read
        return False
