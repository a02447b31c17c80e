"""Figures of what makes tau hard, what would help, and coverage: from records, whatever is null."""

import re
from typing import Any

import pytest
from matplotlib.figure import Figure

from bayes_sensor import figures


def hard(**changes: Any) -> dict[str, Any]:
    return {
        "tau_s": 0.02, "noise": "ar1",
        "weakest": {"tau_s": 0.8, "t0_s[1]": -0.5, "V_mL": 0.1},
        "sd_tau_if_known_s": {"nothing": 0.05, "t0": 0.003, "V": None},
        "by_tau": {"tau_s": [0.001, 0.01, 0.1], "sd_tau_s": [1.0, 0.1, 0.02],
                   "sd_square_s2": [2e-3, 2e-3, 3e-3]},
        "profile": {"tau_s": [0.0, 0.05, 0.1], "drop": [0.0, 1.0, 7.0],
                    "gaussian": [None, None, None], "square": [0.0, 0.7, 6.0]},
        **changes,
    }  # fmt: skip


def help_rows() -> list[dict[str, Any]]:
    row = {"kind": "none", "value": 0.0, "unit": "", "sd_tau_s": 0.02, "lo68_s": 0.01,
           "hi68_s": 0.03, "lo95_s": 0.005, "hi95_s": 0.06, "half_width95_s": 0.03}  # fmt: skip
    return [
        {**row, "change": "as it is", "gain": 1.0},
        {**row, "change": "a faster valve", "gain": 2.5},
        {**row, "change": "more flow", "gain": 1.1},
    ]


def coverage_rows() -> list[dict[str, Any]]:
    return [
        {"setting": setting, "method": method, "parameter": parameter, "level": level,
         "coverage": 0.9, "coverage_lo95": 0.85, "coverage_hi95": 0.94}
        for setting in ("iid", "arma")
        for method in ("crlb_iid", "posterior")
        for parameter in ("tau_s", "V_mL", "t0_s")
        for level in ("68", "95")
    ]  # fmt: skip


def texts(figure: Figure) -> set[str]:
    words = re.findall(r"<text[^>]*>([^<]*)</text>", figures.svg(figure))
    return {word.strip() for word in words}


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (lambda: figures.tau_hard(hard()), {"profile likelihood", "50 ms", "t₀ known"}),
        (lambda: figures.what_would_help(help_rows()), {"as it is", "2.5×", "1.1×"}),
        (
            lambda: figures.coverage(coverage_rows()),
            {"white noise", "ARMA", "posterior", "volume V"},
        ),
    ],
)
def test_drawn_with_its_words_and_the_same_twice(make: Any, wanted: set[str]) -> None:
    assert wanted <= texts(make())
    assert figures.svg(make()) == figures.svg(make())


def test_what_does_not_exist_is_said_or_left_out() -> None:
    assert "no finite bound" in texts(figures.tau_hard(hard()))
    assert "estimate ± sd" not in texts(figures.tau_hard(hard()))
    curve = {**hard()["profile"], "gaussian": [0.2, 0.0, 1.0]}
    assert "estimate ± sd" in texts(figures.tau_hard(hard(profile=curve)))
    nothing = hard(sd_tau_if_known_s={"nothing": None, "t0": None})
    assert "no finite bound" in texts(figures.tau_hard(nothing))


def test_coverage_shows_only_what_is_asked_for() -> None:
    figure = figures.coverage(coverage_rows(), parameters=("t0_s",))
    assert "t₀" in texts(figure) and "volume V" not in texts(figure)
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert len(panels) == 2
    # one line for the limits and one marker, a method; one line at .95
    assert all(len(axes.get_lines()) in (5, 6) for axes in panels)
