"""The notebook on the coating runs from top to bottom and gives the published 12.9 ms."""

import pytest

pytest.importorskip("nbformat")
pytest.importorskip("nbclient")

from test_notebooks import run


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # the Jupyter client's own warnings, not ours
def test_coating() -> None:
    values = run(
        "coating.ipynb",
        {
            "literature": "literature.tau63",
            "lowered": "lowered.tau63",
            "reduced": "short.tau63",
            "converged": "posterior.converged",
            "published": "published.tail_probability",
            "honest": "honest.tail_probability",
            "rows": "len(table)",
        },
    )
    assert values["literature"] == pytest.approx(12.9e-3, rel=0.01)
    assert 48e-3 < values["lowered"] < 49.5e-3
    assert values["reduced"] == pytest.approx(values["literature"], rel=2e-3)
    assert values["converged"]
    assert values["published"] < 1e-3 < values["honest"]
    assert values["rows"] == 7  # the sensor and six different flows
