"""The notebooks on the gap name the sealed cause and an effect that the reader wrote."""

import pytest

pytest.importorskip("nbformat")
pytest.importorskip("nbclient")

from test_notebooks import run


@pytest.mark.filterwarnings("ignore")  # the Jupyter client's own warnings, not ours
def test_the_sealed_cause_is_found() -> None:
    values = run(
        "gap.ipynb",
        {
            "kind": "gap.verdict.kind",
            "likeliest": "gap.verdict.effects[0]",
            "probability": "gap.probabilities.effects[sealed]",
            "sealed": "sealed",
            "true": "next(iter(strength[sealed].values()))",
            "estimated": "next(iter(row.strength.values()))",
            "low": "shrink.tau_after_low_s",
            "high": "shrink.tau_after_high_s",
            "tau": "theta['tau_s']",
            "closed": "shrink.closure.fraction",
            "rival": "shrink.rival_fraction_closed",
        },
    )
    assert values["kind"] in ("effect", "family") and values["likeliest"] == values["sealed"]
    assert values["probability"] > 0.8
    assert values["estimated"] == pytest.approx(values["true"], rel=0.15)
    assert values["low"] < values["tau"] < values["high"]
    assert values["closed"] > max(0.95, values["rival"])


@pytest.mark.filterwarnings("ignore")
def test_an_effect_of_ones_own() -> None:
    values = run(
        "own_effect.ipynb",
        {
            "before": "before.verdict.kind",
            "named": "list(gap.verdict.effects)",
            "strength": "gap.which.set_index('effect').strength['crosstalk']",
            "p": "gap.verdict.probability",
        },
    )
    assert values["before"] == "unlisted"
    assert values["named"] == ["crosstalk"] and values["p"] > 0.9
    assert values["strength"]["pulse"] == pytest.approx(0.04, rel=0.15)
    assert values["strength"]["fading"] == pytest.approx(0.4, rel=0.3)
