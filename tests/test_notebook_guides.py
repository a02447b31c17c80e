"""The guides run from top to bottom, and one number of each is checked."""

import pytest

pytest.importorskip("nbformat")
pytest.importorskip("nbclient")

from test_notebooks import run


@pytest.mark.filterwarnings("ignore")  # the Jupyter client's own warnings, not ours
def test_quickstart() -> None:
    values = run("quickstart.ipynb", {"lo": "lo", "hi": "hi", "n": "len(campaign)"})
    assert values["n"] == 3
    assert 0 < values["lo"] < 0.060 < values["hi"]


@pytest.mark.filterwarnings("ignore")
def test_noise() -> None:
    values = run(
        "noise.ipynb",
        {"phi": "residuals.ar1['phi']", "right": "checks['ar1'].failed",
         "wrong": "checks['white'].failed"},
    )  # fmt: skip
    assert values["phi"] == pytest.approx(0.8, abs=0.02)
    assert values["right"] == [] and "autocorrelation" in values["wrong"]


@pytest.mark.filterwarnings("ignore")
def test_design() -> None:
    values = run(
        "design.ipynb",
        {"before": "proposal.before.half_width95", "after": "proposal.after.half_width95",
         "target": "target", "reached": "proposal.reached"},
    )  # fmt: skip
    assert values["reached"]
    assert values["after"] <= values["target"] < values["before"]
