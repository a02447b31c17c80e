"""Parameters and quantities that are given to a command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.io.json_files import read_json
from bayes_sensor.io.readers.quantities import Kind, read_quantity
from bayes_sensor.io.result_schema import check_result


def read_option(text: str, kind: Kind, option: str) -> float:
    """The number of a quantity given as an option; the message shows how to write it."""
    try:
        return read_quantity(text, kind, option)
    except CampaignError as error:
        raise CampaignError(str(error).replace(f"{option} = ", f"{option} ")) from None


def read_truth(path: Path, design: Campaign) -> dict[str, Any]:
    """Parameters as in fit.json or truth.json, of every experiment of the design."""
    content = _parameters(path, "fit.json or truth.json", "experiments, ..")
    truth = {**content, "experiments": dict(content.get("experiments", {}))}
    for name in design.names_of_experiments:
        if name not in truth["experiments"]:
            raise CampaignError(
                f"{path.name}: it holds no parameters of experiment '{name}'; add them under "
                '"experiments", or choose experiments with --experiments'
            )
    return truth


def read_nominal(path: Path | None) -> dict[str, Any] | None:
    """Parameters of a nominal simulation, as in fit.json or truth.json.

    Raises CampaignError where the file does not hold them.
    """
    return None if path is None else _parameters(path, "fit.json", "experiments")


def _parameters(path: Path, like: str, last: str) -> dict[str, Any]:
    content = read_json(path)
    if isinstance(content, dict) and isinstance(content.get("parameters"), dict):
        content = content["parameters"]
    if not isinstance(content, dict) or "tau_s" not in content:
        raise CampaignError(
            f"{path.name}: expected parameters as in {like} (tau_s, tau_v_s, V_mL, {last}), "
            "but tau_s is not there; give such a file"
        )
    return dict(check_result(content, path, "parameters"))
