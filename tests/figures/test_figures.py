"""Figures: drawn, labelled, the same bytes for the same records, legible in grey."""

import io
import re
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

from bayes_sensor import figures
from bayes_sensor.figures.colours import (
    BLUE,
    COLOURS,
    DATA,
    GROUND,
    INK,
    MODEL,
    ORANGE,
    PALE,
    REGIONS,
)
from bayes_sensor.fit.traces import Trace, envelope

RNG = np.random.default_rng(7)


def trace(name: str = "1", fall: bool = True) -> Trace:
    t = np.arange(0.0, 20.0, 0.01)
    model = np.where(t > 5, 1.0, 0.0) - (np.where(t > 15, 1.0, 0.0) if fall else 0.0)
    y = model + 0.05 * RNG.standard_normal(len(t))
    sd = np.full(len(t), 0.05)

    def part(a: float, b: float) -> Any:
        k = (t >= a) & (t < b)
        return envelope(t[k], y[k], model[k], sd[k], 100)

    return Trace(
        name, 75.0, 0.11, 5.0, 15.0 if fall else None, 4.5, 14.5 if fall else None, 0.05,
        part(0, 20), part(4, 8), part(14, 18) if fall else None,
    )  # fmt: skip


def residuals() -> dict[str, Any]:
    lag = np.arange(60)
    edges = np.linspace(-0.2, 0.2, 9)
    return {
        "acf": {"lag_s": 0.01 * lag, "value": 0.8**lag, "ar1": 0.79**lag},
        "white_band": 0.02,
        "ar1": {"phi": 0.79, "phi_interval_s": 0.01},
        "histogram": {"edges_V": edges, "count": [1, 5, 20, 60, 61, 22, 4, 1], "bin_V": 0.05},
        "variance_vs_concentration": {
            "concentration_low": [0.0, 0.05], "concentration_high": [0.05, 0.1],
            "sd_V": [0.04, None], "law_sd_V": [0.041, None],
        },
        "signal_unit": "V",
    }  # fmt: skip


def chains() -> tuple[list[str], Any]:
    names = ["tau_s", "tau_v_s", "V_mL", "y0_V[1]", "phi", "sigma0_V", "sigma1_V"]
    values = RNG.standard_normal((4, 600, len(names))) * 0.01 + np.arange(1, len(names) + 1)
    return names, values


def delay_record() -> dict[str, Any]:
    def line(outlier: bool) -> dict[str, Any]:
        return {
            "r2": 0.94,
            "band": {"inverse_flow_s_per_L": [6, 20], "fit_s": [0.8, 2.4], "lo95_s": [0.5, 2.1],
                     "hi95_s": [1.1, 2.7]},
            "points": [
                {"experiment": str(k), "inverse_flow_s_per_L": x, "delay_s": 0.1 + 0.11 * x,
                 "used": not (outlier and k == 4)}
                for k, x in enumerate((6.7, 8.6, 10.0, 13.3, 17.1), 1)
            ],
        }  # fmt: skip

    return {"start": line(True), "end": line(False)}


def bounds_record() -> dict[str, Any]:
    row = {"estimate": 0.02, "sd": 0.01, "lo68": 0.01, "hi68": 0.03, "lo95": 0.0, "hi95": 0.04,
           "lo997": 0.0, "hi997": 0.05}  # fmt: skip
    limit = {**row, "sd": None, "lo95": None, "lo68": None}
    each = {"tau_s": row, "tau_v_s": limit, "V_mL": None}
    return {"methods": {"crlb_iid": {"parameters": each}, "posterior": {"parameters": each}}}


def study() -> list[dict[str, Any]]:
    return [
        {"step": s, "method": m, "difference": d, "tau_s": 0.01 * (1 + s), "tau_v_s": 0.002,
         "V_mL": 0.2, "identified": s > 1e-4}
        for s in (1e-5, 1e-3, 1e-1) for m in ("euler", "exact") for d in ("forward", "central")
    ]  # fmt: skip


def predictive_record(unit: str = "V") -> dict[str, Any]:
    def part(x: list[float], middle: list[float]) -> dict[str, Any]:
        m = np.array(middle)
        return {"x": x, "observed": (1.01 * m).tolist(), "low": (0.9 * m).tolist(),
                "middle": middle, "high": (1.1 * m).tolist(), "p_value": 0.3}  # fmt: skip

    return {
        "autocorrelation": part([1, 3, 10, 30], [0.8, 0.5, 0.1, 0.01]),
        "variance": part([0.0, 0.05, 0.1], [0.002, 0.003, 0.004]),
        "spectrum": part([0.1, 1, 10, 100], [9, 9, 5, 0.2]),
        "pit": {"counts": [100, 98, 103, 99], "p_uniform": 0.0},
    }


def gap_record(nominal: bool = True) -> dict[str, Any]:
    where = [
        {"experiment": e, "phase": p, "excess_rms_V": x, "share": s, "p_value": q}
        for e in ("1", "<b>") for p, x, s, q in
        (("rise", 0.001, 0.1, 0.5), ("fall", 0.004, 0.4, 0.001), ("tail", None, 0.0, None))
    ]  # fmt: skip
    which = [
        {"effect": e, "family": f, "probability": p}
        for e, f, p in (("none", None, 0.0001), ("flow_switching", "asymmetry", 0.9),
                        ("daq_filter", "hidden", 0.0499), ("unlisted", None, 0.05))
    ]  # fmt: skip
    return {
        "budget": {"calibrated_rms_V": 0.0654, "noise_floor_rms_V": 0.0652, "excess_rms_V": 0.004,
                   "nominal_rms_V": 0.09 if nominal else None},
        "shrink": {"after_excess_rms_V": 0.0005, "withheld": not nominal},
        "where": where,
        "which": which,
        "hidden": {"lag": "tau",
                   "effects": [{"effect": "daq_filter", "d": 0.05, "tau_shift_s": 0.0025},
                               {"effect": "dead_volume", "d": 5.0, "tau_shift_s": -0.04},
                               {"effect": "heavy_tails", "d": None, "tau_shift_s": 0.0}],
                   "tau_envelope_s": [0.02, 0.11]},
    }  # fmt: skip


MAKERS = {
    "overlay": (lambda: figures.overlay(trace()), ("time (s)", "signal (V)", "residual (mV)")),
    "overlay_up": (lambda: figures.overlay(trace(fall=False)), ("start", "whole record")),
    "histogram": (lambda: figures.histogram(residuals(), 0.05), ("samples per bin",)),
    "autocorrelation": (
        lambda: figures.autocorrelation(residuals(), [trace(), trace("2")]),
        ("lag (s)", "autocorrelation", "AR(1), φ = 0.790", "time, experiments joined (s)"),
    ),
    "autocorrelation_of_each": (
        lambda: figures.autocorrelation(
            residuals() | {"ar1": {"phi[1]": 0.7, "phi[2]": 0.88, "phi": 0.79}}
        ),
        ("AR(1), φ of each",),
    ),
    "spread": (lambda: figures.spread(residuals()), ("standard deviation (mV)",)),
    "delays": (
        lambda: figures.delays(delay_record(), {str(k): 0.1 + 0.02 * (k % 3) for k in range(6)}),
        ("1/Q (s/L)", "start delay (s)", "end delay (s)", "4, outlier", "95 % prediction"),
    ),
    "corner": (lambda: figures.corner(*chains()), ("sensor τ (ms)", "volume V (mL)", "φ")),
    "traces": (lambda: figures.traces_and_ranks(*chains()), ("rank among all draws", "chains")),
    "intervals": (
        lambda: figures.intervals(bounds_record(), {"tau_s": 0.02}),
        ("posterior", "Cramér-Rao, iid noise", "valve τᵥ (ms)", "no value"),
    ),
    "step_study": (
        lambda: figures.step_study(study(), {"tau_s": 0.0056}),
        ("relative step", "3 sd of sensor τ (ms)", "published"),
    ),
    "diffusion": (
        lambda: figures.diffusion(
            {"probe": {"t_ms": [0, 10, 40, 80], "response": [0, 0.5, 0.9, 1.0]}, "tau63_ms": 12.9,
             "t90_ms": 40.0, "tau_fit_ms": 13.0}
        ),
        ("time (ms)", "63.2 % after 12.9 ms"),
    ),
    "predictive": (
        lambda: figures.predictive(predictive_record()),
        ("lag (samples)", "frequency (Hz)", "standard deviation (mV)", "95 % of replicates",
         "autocorrelation, p = 0.3", "next-sample forecasts, p &lt; 0.001"),
    ),
    "responses": (
        lambda: figures.responses([trace(), trace("2", fall=False)]),
        ("time after the command (s)", "signal (V)", "11 % test gas", "4.5 L/min"),
    ),
    "gap_where": (
        lambda: figures.gap_where(gap_record()["where"]),
        ("experiment", "phase of the step", "excess RMS (mV)", "40 %", "fall", "&lt;b&gt;"),
    ),
    "gap_which": (
        lambda: figures.gap_which(gap_record()),
        ("probability (%)", "flow switching", "unlisted", "90.0", "&lt;0.1", "asymmetry"),
    ),
    "gap_residuals": (
        lambda: figures.gap_residuals(
            [{"experiment": "<b>", "whitened": [0.1, -3.0, 2.0], "phase": [0, 2, 4]}] * 2
        ),
        ("baseline", "rise", "fall", "strips of ± 3.5", "&lt;b&gt;"),
    ),
    "gap_hidden_whole": (
        lambda: figures.gap_hidden(
            {"lag": "tau",
             "effects": [{"effect": "daq_filter", "d": 0.0, "tau_shift_s": 0.1, "contradicted": c,
                          "tau_with_it_s": 0.05, "tau_low_s": 0.04, "tau_high_s": 0.06}
                         for c in (True, False)], "tau_envelope_s": [None, None]}
        ),
        ("τ with it (ms), 95 % intervals", "contradicted by the data", "could hide"),
    ),
    "gap_hidden": (
        lambda: figures.gap_hidden(gap_record()["hidden"], 0.048),
        ("shift of τ (ms)", "detectability d (sd)", "could hide",
         "would be seen", "envelope of τ", "daq filter"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MAKERS)
def test_a_figure_is_drawn_and_labelled(name: str) -> None:
    make, labels = MAKERS[name]
    figure = make()
    assert isinstance(figure, Figure)
    pixels = imread(io.BytesIO(figures.png(figure, 60)))[..., :3]
    # a frame with ticks alone covers about one pixel in a hundred
    assert np.mean(pixels.min(axis=-1) < 0.9) > 0.02
    drawing = figures.svg(figure)
    for label in labels:
        assert f">{label}<" in drawing, f"{name}: '{label}' is missing"
    assert plt.get_fignums() == [], "a figure was left open in pyplot"


@pytest.mark.parametrize("name", ["delays", "corner", "autocorrelation", "gap_where"])
def test_the_same_records_give_the_same_bytes(name: str) -> None:
    figure = MAKERS[name][0]
    state = RNG.bit_generator.state
    first = figure()
    RNG.bit_generator.state = state
    second = figure()
    assert figures.svg(first) == figures.svg(second)
    assert figures.png(first, 50) == figures.png(second, 50)
    assert figures.pdf(first) == figures.pdf(second)


def test_a_hostile_name_is_text_in_the_drawing() -> None:
    where = [{**gap_record()["where"][0], "experiment": name} for name in
             ("<script>x</script>", "$a^2 & b")]  # fmt: skip
    drawing = figures.svg(figures.gap_where(where))
    assert "<script" not in drawing
    assert "&lt;script" in drawing
    assert "$a^2 &amp; b" in drawing  # not taken for a formula


def test_colours_that_meet_in_one_plot_differ_in_grey() -> None:
    def grey(colour: str) -> float:
        return float(np.dot(to_rgb(colour), (0.299, 0.587, 0.114)))

    pairs = [(DATA, MODEL), (DATA, INK), (DATA, ORANGE), (PALE, BLUE), (PALE, MODEL), (ORANGE, INK),
             (GROUND, REGIONS[1]), (REGIONS[1], BLUE)]  # fmt: skip
    for a, b in pairs:
        assert abs(grey(a) - grey(b)) > 0.15, (a, b)


def test_every_colour_of_a_drawing_is_known_to_the_page() -> None:
    known = {*COLOURS, "#ffffff", "#000000"}
    for name, (make, _) in MAKERS.items():
        used = set(re.findall(r"#[0-9a-f]{6}\b", figures.svg(make())))
        assert used <= known, f"{name}: {used - known}"


def test_the_step_study_is_drawn_where_no_bound_is_positive() -> None:
    rows = [
        {"method": method, "difference": difference, "step": step, "identified": True,
         "tau_s": 0.0, "tau_v_s": None, "V_mL": 1e3 * step}
        for method in ("euler", "exact")
        for difference in ("forward", "central")
        for step in (1e-4, 1e-2)
    ]  # fmt: skip
    figure = figures.step_study(rows)
    assert figures.png(figure).startswith(b"\x89PNG")
    assert [axes.get_yscale() for axes in figure.axes[:3]] == ["linear", "linear", "log"]
