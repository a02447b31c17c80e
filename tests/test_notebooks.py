"""Every notebook runs from top to bottom, and one number of each is checked."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")


def run(name: str, expressions: dict[str, str]) -> dict[str, float]:
    """Execute a notebook from the repository's root; values of ``expressions`` at its end."""
    notebook = nbformat.read(ROOT / "notebooks" / name, as_version=4)
    probe = ", ".join(f"{key!r}: {code}" for key, code in expressions.items())
    notebook.cells.append(nbformat.v4.new_code_cell(f"import json; print(json.dumps({{{probe}}}))"))
    nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(ROOT)}}
    ).execute()
    shown = [
        output["data"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output["output_type"] in ("execute_result", "display_data")
    ]
    for data in shown:  # a figure that is only handed back is shown as its name
        assert not data.get("text/plain", "").startswith("<Figure") or "image/png" in data, name
    return json.loads(notebook.cells[-1]["outputs"][0]["text"])


def test_stored_notebooks_hold_no_outputs() -> None:
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        for cell in json.loads(path.read_text())["cells"]:
            assert not cell.get("outputs"), f"{path.name}: strip its outputs"


@pytest.mark.filterwarnings("ignore")  # the Jupyter client's own warnings, not ours
def test_main_job() -> None:
    values = run(
        "main_job.ipynb",
        {
            "lo": "lo",
            "hi": "hi",
            "truth": "truth['tau_s']",
            "rms": "fit.rms",
            "converged": "posterior.converged",
            "outliers": "start['outliers']",
            "iid": "bounds.to_json()['methods']['crlb_iid']['parameters']['V_mL']['sd']",
            "ar1": "bounds.to_json()['methods']['crlb_ar1']['parameters']['V_mL']['sd']",
        },
    )
    assert values["converged"]
    assert values["lo"] < values["truth"] < values["hi"]
    assert values["rms"] == pytest.approx(0.0653, abs=3e-4)
    assert values["outliers"] == ["4"]
    # coloured noise widens the bound by about sqrt((1 + phi)/(1 - phi)) = 3
    assert 2.5 < values["ar1"] / values["iid"] < 3.5
