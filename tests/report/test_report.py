"""The report: self-contained, escaped, in order, honest about what failed, alive in a browser."""

import io
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.image import imread

from bayes_sensor import figures, report
from bayes_sensor.analysis import job
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.cli.simulate_campaigns import published_design
from bayes_sensor.figures.colours import COLOURS
from bayes_sensor.fit.samples import load_samples
from bayes_sensor.io.check import campaign_rows
from bayes_sensor.io.json_files import plain
from bayes_sensor.report import (
    FORMATS,
    PAGES,
    Choice,
    Report,
    Table,
    alerts,
    assemble,
    headline,
    html,
    markdown,
    number,
    p_words,
    pdf,
    read_results,
    with_spread,
    write_report,
)
from bayes_sensor.report.drawing import inline_svg
from bayes_sensor.report.first_page import Fact, first_page
from bayes_sensor.report.gap_words import gap_sentence, with_the_effect
from bayes_sensor.report.html import zoom_data
from bayes_sensor.report.markdown import escaped
from bayes_sensor.report.parts import (
    Section,
    draw,
    numbering,
    p_value,
    pieces,
    see,
    to_spread,
)
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.coating_section import coating
from bayes_sensor.report.sections.fit_section import fitted
from bayes_sensor.report.sections.gap_tables import strength_words
from bayes_sensor.report.sections.noise_section import noise
from bayes_sensor.report.sections.tau_section import time_constant
from bayes_sensor.report.stage_values import stage_values
from bayes_sensor.report.words import typeset
from bayes_sensor.residuals import TAKE_AS_THEY_ARE

HOSTILE = "<script>document.title='taken'</script> $x^2$ \"&'"
ORDER = [
    "What was measured", "How well does the model fit", "What is the sensor&#39;s time constant",
    "Is the noise model adequate", "What makes it hard", "Where is the gap, and what causes it",
    "How do the delays depend on flow", "Response times", "What to measure next",
    "How it was computed",
]  # fmt: skip
DESIGN = """title = "</title><script>document.title='taken'</script>"
[rig]
sensor_is = "faster"
"""


def run(*arguments: str | Path) -> int:
    return exit_code([str(a) for a in arguments])


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder of ``analyze``; one experiment has a hostile name, one no step down."""
    folder = tmp_path_factory.mktemp("analysed")
    name = json.dumps(HOSTILE)
    flows = (("4.0", "0.5"), ("8.0", "1.0"), ("5.0", "1.0"), ("3.0", "0.5"))
    text = DESIGN
    for k, (carrier, test) in enumerate(flows):
        text += (
            f"[[experiment]]\nname = {name if k == 0 else chr(34) + str(k) + chr(34)}\n"
            f'carrier_flow = "{carrier} L/min"\ntest_gas_flow = "{test} L/min"\n'
            'commanded_on = "3 s"\ninterval = "10 ms"\nduration = "18 s"\n'
        )
        text += 'commanded_off = "11 s"\n' if k != 2 else ""
    (folder / "design.toml").write_text(text)
    noise = ["--tau", "150 ms", "--sigma0", "5 mV", "--sigma1", "3 mV", "--quiet"]
    data = folder / "data"
    assert run("simulate", "--design", folder / "design.toml", "--out", data, *noise) == 0
    (folder / "over.toml").write_text(
        '[bounds]\nmethods = ["crlb_iid", "crlb_iid_one_percent_step", "crlb_ar1", "posterior"]\n'
    )
    options = ["--sampler", "independence", "--config", folder / "over.toml", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:  # the diagnosis takes long and has its own tests
        for table in (job.STEPS, job.SAVES):
            patch.setitem(table, "analyze", tuple(s for s in table["analyze"] if s != "gap"))
        code = run("analyze", data / "campaign.toml", "--out", folder / "out", *options)
    assert code in (0, 3)
    return folder / "out"


def drawn(saved: Saved, pages: str = "full", folded: bool = True) -> Report:
    """A report with its figures."""
    made = assemble(saved, pages, folded)
    draw(made.to_draw())
    return made


@pytest.fixture(scope="module")
def whole(analysed: Path) -> Report:
    """What every format of the full report is made from, drawn once."""
    return drawn(read_results(analysed))


@pytest.fixture(scope="module")
def saved(whole: Report) -> Saved:
    """The results behind it."""
    return whole.saved


def facts(saved: Saved) -> dict[str, str]:
    """The sentences of the first page by their label."""
    return {fact.label: fact.text for fact in first_page(saved, []).facts}


# --- the published bounds

STUDY = [
    {"step": step, "method": "exact", "difference": "central", "tau_s": 1e-3, "tau_v_s": 1e-3,
     "V_mL": 0.1, "identified": True}
    for step in (1e-3, 1e-2)
]  # fmt: skip
"""as the analysis of a campaign with the published sensor makes it"""


def test_published_bounds_stand_beside_those_of_the_published_design_alone(
    analysed: Path, tmp_path: Path
) -> None:
    shutil.copytree(analysed, tmp_path / "out")
    bounds = json.loads((analysed / "bounds.json").read_text())
    bounds["naive"]["at"]["tau_v_s"] = 0.8577  # as the published rig's, by chance
    bounds["step_study"] = STUDY
    (tmp_path / "out" / "bounds.json").write_text(json.dumps(bounds))
    published = campaign_rows(published_design()[0])
    mine = json.loads((analysed / "campaign.json").read_text())
    other = [{**row, "total_flow_L_min": 1.02 * row["total_flow_L_min"]} for row in published]
    for experiments, stars in ((mine["experiments"], False), (other, False), (published, True)):
        rows = plain([{**row, "file": ""} for row in experiments])
        for compared in (False, True):
            saved = replace(
                read_results(tmp_path / "out", compared), campaign={**mine, "experiments": rows}
            )
            section = time_constant(saved)
            assert section is not None
            found = [p for p in section.content if getattr(p, "key", "") == "step_study"]
            assert len(found) == compared
        assert ("Stars: the published bounds." in found[0].caption) == stars


def test_what_concerns_the_published_sensor_is_shown_where_it_is_asked_for(saved: Saved) -> None:
    def told(saved: Saved) -> str:
        made = assemble(saved)
        texts = [t for s in made.sections for t in (s.title, s.answer, *s.paragraphs)]
        for section in made.sections:
            for part in section.content:
                texts += [part.key, part.caption]
                texts += [str(cell) for row in getattr(part, "rows", []) for cell in row]
        return " ".join(texts)

    record = {**(saved.coating or {}), "d_zif8": DIFFUSIVITY}
    bounds = {**(saved.bounds or {}), "step_study": STUDY}
    saved = replace(saved, coating=record, bounds=bounds, gap=diagnosis([HOSTILE, "1", "2"]))
    special = ("ZIF-8", "Euler", "teps of 1 % in every parameter", "finite difference",
               "How often diagnoses are right", "the coating")  # fmt: skip
    plain_text = told(saved)
    for words in special:
        assert words not in plain_text, words
    for shown in (
        replace(saved, compare_published=True),
        replace(saved, campaign={**saved.campaign, "coating": "zif8"}),
    ):
        text = told(shown)
        for words in ("ZIF-8", "Euler", "Steps of 1 % in every parameter", "finite difference",
                      "How often diagnoses are right"):  # fmt: skip
            assert words in text, words


DIFFUSIVITY = {
    "d_zif8_m2_per_s": {"median": 7e-11, "lo68": 3e-11, "hi68": 1e-9, "lo95": 1e-11, "hi95": None},
    "d_literature_m2_per_s": 1.71e-10, "tail_probability": 0.2, "tail_resolution": 1e-3,
    "tau_literature_ms": {"median": 13.0, "lo95": 10.0, "hi95": 16.0},
    "ratio": {"median": 3.0, "lo95": 1.0, "hi95": 5.0}, "tolerances": {"d_pdms": 0.1},
}  # fmt: skip


# --- words


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0481, "0.0481"), (58.2345, "58.2"), (None, "–"), (-1.5e-7, "-1.50e-07"), (0.0, "0"),
     (123456.7, "123457")],
)  # fmt: skip
def test_numbers_as_text(value: float | None, text: str) -> None:
    assert number(value) == text


def test_rounding_follows_the_spread() -> None:
    assert with_spread(48.1234, 12.0) == "48"
    assert with_spread(0.85767, 0.0021) == "0.8577"
    assert with_spread(3.0, None) == "3.000"
    assert p_words(0.0) == "below 0.001" and p_words(0.25) == "0.25"


def test_headline_of_a_limit_and_of_an_interval() -> None:
    row = {"q2.5": 0.001, "q50": 0.022, "q97.5": 0.064}
    priors = [{"prior": "half_normal", "upper95_s": 0.057}]
    naive = {"naive": {"crlb_iid": {"tau_s": 0.0214}, "crlb_iid_one_percent_step": None}}
    found = headline({"parameters": {"tau_s": row}, "tau_under_priors": priors}, naive)
    assert found is not None and found.is_limit and found.limit == "57 ms"
    assert str(found) == (
        "tau = 22 ms, 95 % interval [1, 64] ms (posterior, AR(1) noise); "
        "the iid Cramer-Rao bound alone would have said ± 42 ms"
    )
    row = {"q2.5": 0.040, "q50": 0.048, "q97.5": 0.056}
    white = {"noise": {"autocorrelation": "white"}}
    found = headline({"parameters": {"tau_s": row}}, None, white)
    assert found is not None and not found.is_limit and "white noise" in str(found)
    assert headline(None, None) is None


def test_the_first_page_says_one_tau_the_chain_the_noise_and_the_verdict(saved: Saved) -> None:
    assert saved.posterior is not None and saved.bounds is not None and saved.residuals is not None
    row = {"q2.5": 0.001, "q50": 0.022, "q97.5": 0.064}
    priors = [{"prior": "half_normal", "upper95_s": 0.057}]
    verdict = {
        "sentence": "The cause is flow_settling. It closes 97% of the gap.",
        "effects": ["flow_settling"],
        "kind": "effect",
        "probability": 0.95,
    }
    shrink = {
        "withheld": False,
        "fraction_closed": 0.97,
        "tau_after_s": 0.04,
        "tau_after_lo_s": 0.031,
        "tau_after_hi_s": 0.052,
    }
    found = {
        "verdict": verdict,
        "shrink": shrink,
        "hidden": {"lag": "tau", "tau_envelope_s": [0.0068, 0.24]},
    }
    saved = replace(
        saved,
        posterior={
            **saved.posterior, "parameters": {**saved.posterior["parameters"], "tau_s": row},
            "tau_under_priors": priors,
        },
        residuals={
            **saved.residuals, "ar1": {"phi": 0.8, "phi_interval_s": 0.01}, "adequate": True,
        },
        predictive=None,
        gap=found,
    )  # fmt: skip
    # who reads only the top must not take home the tau of a model that is known to be wrong
    page, told = first_page(saved, []), facts(saved)
    assert page.tau == "τ = 40 ms, 95 % interval [31, 52] ms (with flow settling in the model)"
    assert "Without that: τ = 22 ms, 95 % interval [1, 64] ms (posterior, AR(1) noise)" in page.why
    assert "--with-effect flow_settling" in page.why
    assert told["Whole chain"].endswith("without what the model lacks.") and "Limit" not in told
    model = told["Model right?"]
    assert model.startswith("No. The cause is flow settling. It closes 97 % of the gap.")
    sampled = {**saved.posterior, "with_effects": ["flow_settling"]}
    assert first_page(replace(saved, posterior=sampled), []).tau.startswith("τ = 22 ms")
    right = {**found, "verdict": {"kind": "none", "effects": [], "probability": 0.8,
                                  "sentence": "Nothing is missing."}}  # fmt: skip
    plain = replace(saved, gap=right)
    page, told = first_page(plain, []), facts(plain)
    assert page.tau.startswith("τ = 22 ms, 95 % interval [1, 64] ms")
    assert "63 %" in page.why and "the posterior's alone averages" in page.why
    assert "of 3 intervals" in page.why  # the published recipe is not among them
    assert "upper limit, τ < 57 ms" in told["Limit"]
    assert "L/min" in told["Whole chain"] and "t90" in told["Whole chain"]
    assert "correlation 0.80 after 10.0 ms" in told["Noise"] and "passes" in told["Noise"]
    unsaid = {**verdict, "sentence": "The cause is flow_settling."}
    told = facts(replace(saved, gap={**found, "verdict": unsaid}))
    assert "With the best explanation in the model 97 % of the gap closes." in told["Model right?"]
    none = {"sentence": "Nothing. With them tau could be anywhere from 6.8 to 240 ms.",
            "effects": [], "kind": "none", "probability": 0.7}  # fmt: skip
    # beside a limit, the lower end of the envelope would contradict it
    told = facts(replace(saved, gap={**found, "verdict": none}))
    assert told["Model right?"] == "Nothing. With them τ could reach 240 ms."
    assert gap_sentence({**found, "verdict": none}, False).endswith("could be from 6.8 to 240 ms.")
    bare = replace(saved, posterior=None, bounds=None, gap=None, residuals=None)
    assert first_page(bare, []).tau == "" and facts(bare) == {}


@pytest.mark.parametrize(
    ("sd", "said"),
    [(0.002, "too narrow, by a factor of 4.1"), (0.02, "2.5 times as wide as"),
     (0.0083, "about as wide as")],
)  # fmt: skip
def test_the_classical_bound_is_called_what_it_is_here(saved: Saved, sd: float, said: str) -> None:
    assert saved.posterior is not None and saved.bounds is not None
    row = saved.posterior["parameters"]["tau_s"] | {"q2.5": 0.032, "q50": 0.048, "q97.5": 0.064}
    naive = {**saved.bounds["naive"], "crlb_iid": {"tau_s": sd}, "crlb_ar1": {"tau_s": 0.01}}
    parameters = {**saved.posterior["parameters"], "tau_s": row}
    changed = replace(
        saved,
        posterior={**saved.posterior, "parameters": parameters},
        bounds={**saved.bounds, "naive": naive},
        residuals={**(saved.residuals or {}), "ar1": {"phi": 0.8}},
    )
    section = time_constant(changed)
    assert section is not None
    (text,) = [p for p in section.paragraphs if "classical Cramér-Rao" in p]
    assert f"± {number(1.96e3 * sd, 2)} ms" in text and said in text
    assert "(φ = 0.80); with that in it the bound becomes ± 20 ms." in text
    white = replace(changed, residuals={**(saved.residuals or {}), "ar1": {"phi": 0.0}})
    section = time_constant(white)
    assert section is not None and "Neighbouring" not in " ".join(section.paragraphs)


def test_the_first_page_has_the_chain_and_the_worst_overlay(saved: Saved, whole: Report) -> None:
    chain, overlay = whole.first.content
    assert chain.key == "chain" and whole.numbers["chain"] == "Figure 1"
    drawing = ElementTree.fromstring(chain.drawing)
    words = " ".join("".join(element.itertext()) for element in drawing)
    assert saved.posterior is not None
    for name in ("valve", "manifold", "sensor", "τᵥ = ", "V = "):
        assert name in words
    assert saved.traces is not None
    worst = max(saved.traces, key=lambda t: t.rms / float(np.sqrt(np.mean(t.whole.sd**2))))
    assert overlay.key == f"overlay_{1 + saved.traces.index(worst)}"
    others = [p.key for s in whole.sections for p in s.content if p.key.startswith("overlay")]
    assert len(others) == len(saved.traces) - 1 and overlay.key not in others


def test_the_chain_is_drawn_for_any_rig(saved: Saved) -> None:
    def words(**changes: Any) -> list[list[str]]:
        campaign = {**saved.campaign, **changes.pop("campaign", {})}
        stages = stage_values(replace(saved, campaign=campaign, **changes))
        return [[stage.name, *stage.lines] for stage in stages]

    row = {"q2.5": 0.9, "q50": 1.0, "q97.5": 1.1}
    stages = {"stages": ["line", "drier: lag", "sensor"]}
    parameters = {"tau_s[A]": row, "tau_s[B]": {k: 3 * v for k, v in row.items()},
                  "V_line_mL": {k: 60 * v for k, v in row.items()},
                  "tau_drier_s": {**row, "q2.5": 0.001}}  # fmt: skip
    posterior = {"parameters": parameters, "converged": True}
    found = words(campaign=stages, posterior=posterior, bounds=None)
    flow = sorted(e["total_flow_L_min"] for e in saved.campaign["experiments"])
    ends = [number(3.6 / q, 2) for q in (flow[-1], flow[0])]
    assert found == [
        ["line", "V = 60 mL", f"{ends[0]} to {ends[1]} s"],
        ["drier", "τ < 1.1 s"],
        ["sensor", "A: τ = 1.00 s", "B: τ = 3.00 s"],
    ]
    without_flow = {**stages, "experiments": [{"experiment": "1"}]}
    found = words(campaign=without_flow, posterior=posterior, bounds=None)
    assert found[0] == ["line", "V = 60 mL"]
    two = replace(saved, posterior=posterior, bounds=None)
    assert first_page(two, []).tau.startswith("τ[A] = 1.00 s, 95 % interval [0.90, ")
    lags = [{"q2.5": 0.05, "q50": 0.1, "q95": 0.14, "q97.5": 0.15}, {**row, "q95": 1.05}]
    undecided = {"parameters": {"V_mL": row, "tau_s": None}, "order": "undecided", "lags_s": lags,
                 "converged": True, "assignments": []}  # fmt: skip
    valve, _, sensor = words(posterior=undecided, bounds=None)
    assert valve[1:] == sensor[1:] == ["100 ms", "or 1.00 s"]
    # nothing that the first sentence does not say
    close = [{"q2.5": 0.1, "q50": 0.2, "q95": 0.29, "q97.5": 0.3},
             {"q2.5": 0.25, "q50": 0.3, "q95": 0.39, "q97.5": 0.4}]  # fmt: skip
    valve, _, sensor = words(posterior={**undecided, "lags_s": close}, bounds=None)
    assert valve[1:] == sensor[1:] == ["in [100, 400] ms"]
    over = {**undecided, "lags_s": close, "hidden_by_sampling_s": 0.5}
    valve, manifold, sensor = words(posterior=over, bounds=None)
    assert valve[1:] == sensor[1:] == ["< 0.23 s"] and manifold == ["manifold"]
    assert words(campaign={"stages": []}) == []
    hostile = figures.chain([figures.Box("<b>&", ("<script>",))])
    assert "<script" not in hostile and "&lt;b&gt;&amp;" in hostile


def test_the_headline_has_the_cause_of_a_misfit_in_its_model(saved: Saved) -> None:
    shrink = {"tau_after_s": 40.0, "tau_after_lo_s": 31.0, "tau_after_hi_s": 52.0}
    found = {"verdict": {"kind": "family", "effects": ["drift", "hum"]}, "shrink": shrink,
             "hidden": {"lag": "tau"},
             "tau_with_discrepancy_s": {"q2.5": 1.0, "q50": 2.0, "q97.5": 3.0}}  # fmt: skip
    assert saved.posterior is not None
    told = headline(saved.posterior, saved.bounds, None, found)
    plain = headline(saved.posterior, saved.bounds)
    assert told is not None and plain is not None
    assert told.text == (
        "tau = 40 s, 95 % interval [31, 52] s (with the likely explanations of the misfit in turn)"
    )
    assert f"; without it {plain.text}; the iid" in str(told) and told.ends_s == (31.0, 52.0)
    assert told.option == "--with-effect drift"
    unlisted = {**found, "verdict": {"kind": "unlisted", "effects": []}}
    told = headline(saved.posterior, saved.bounds, None, unlisted)
    assert told is not None and told.text.startswith(
        "tau = 2.0 s, 95 % interval [1.0, 3.0] s (with"
    )
    for posterior, gap in (
        ({**saved.posterior, "with_discrepancy": True}, unlisted),
        (saved.posterior, {**unlisted, "tau_with_discrepancy_s": None}),
        (saved.posterior, {**found, "shrink": {**shrink, "withheld": True}}),
    ):
        told = headline(posterior, saved.bounds, None, gap)
        assert told is not None and not told.without, gap


def test_no_section_contradicts_the_gap(saved: Saved) -> None:
    verdict = {"sentence": "Found.", "effects": ["flow_settling"], "kind": "effect",
               "probability": 0.95}  # fmt: skip
    shrink = {"withheld": False, "tau_after_s": 0.04, "tau_after_lo_s": 0.031,
              "tau_after_hi_s": 0.052}  # fmt: skip
    found = {"verdict": verdict, "shrink": shrink, "hidden": {"lag": "tau"}}
    plain, blamed = replace(saved, gap=None), replace(saved, gap=found)
    for make, said in (
        (time_constant, "With flow settling in the model τ is 40 ms, 95 % interval [31, 52] ms"),
        (coating, "uses the posterior without the effect"),
        (fitted, "All of them together do"),
    ):
        for each in (plain, blamed):
            section = make(each)
            assert section is not None
            text = " ".join([section.answer, *section.paragraphs])
            assert (said in text) == (each is blamed), make
    assert plain.posterior is not None
    sampled = {**plain.posterior, "with_effects": ["flow_settling"]}
    assert with_the_effect(replace(blamed, posterior=sampled)) == ""
    alone = facts(replace(blamed, posterior=None, bounds=None))  # as bayes-sensor gap leaves it
    assert alone["Model right?"].startswith("No. Found. With flow settling in the model τ is 40 ms")
    noisy = {**found, "verdict": {**verdict, "effects": ["heavy_tails"]},
             "shrink": {"withheld": True}}  # fmt: skip
    assert with_the_effect(replace(plain, gap=noisy)) == ""
    # what is in the noise has a closed fraction, but moves no tau
    hum = {**found, "verdict": {**verdict, "effects": ["mains_pickup"]},
           "shrink": {**shrink, "explanation": "mains_pickup", "of_mean": False}}  # fmt: skip
    assert with_the_effect(replace(plain, gap=hum)) == ""


def test_intervals_of_tau_that_differ_are_set_side_by_side(
    saved: Saved,
) -> None:
    assert saved.posterior is not None and saved.bounds is not None
    row = saved.posterior["parameters"]["tau_s"] | {"q2.5": 0.001, "q97.5": 0.064}
    posterior = saved.posterior | {"parameters": saved.posterior["parameters"] | {"tau_s": row}}
    estimate = {
        "estimate": 0.03,
        "lo95": 0.0,
        "hi95": 0.072,
        "lo68": 0.01,
        "hi68": 0.05,
        "sd": 0.02,
    }
    profile = {"parameters": {"tau_s": estimate}, "status": "ok", "assumes": "AR(1)"}
    bounds = saved.bounds | {"methods": saved.bounds["methods"] | {"profile": profile}}
    shrink = {"withheld": True, "tau_after_s": 0.04, "tau_after_lo_s": 0.031,
              "tau_after_hi_s": 0.052}  # fmt: skip
    gap = {"verdict": {"kind": "none", "effects": []}, "shrink": shrink, "hidden": {"lag": "tau"}}

    def said(saved: Saved) -> str:
        section = time_constant(saved)
        assert section is not None
        return " ".join(p for p in section.paragraphs if p.startswith("The intervals of τ"))

    alone = replace(saved, posterior=posterior, bounds=None, gap=None)
    assert said(alone) == ""
    both = said(replace(alone, bounds=bounds))
    assert "[1, 64] ms counts the prior" in both and "[0, 72] ms has no prior" in both
    assert "diagnosis" not in both
    assert "[31, 52] ms averages over what may be wrong" in said(replace(alone, gap=gap))


def test_a_noise_law_whose_replicas_differ_is_not_called_adequate(
    saved: Saved,
) -> None:
    assert saved.residuals is not None and saved.predictive is not None
    residuals = {**saved.residuals, "adequate": True}
    right = {**saved.predictive, "failed": [], "status": "Alike."}
    wrong = {**right, "failed": ["spectrum"], "status": "Not alike: spectrum (p 3e-05)."}
    for predictive, begin in ((right, "Yes. "), (wrong, "Not fully. ")):
        section = noise(replace(saved, residuals=residuals, predictive=predictive))
        assert section is not None and section.answer.startswith(begin)
    assert "spectrum (p below 0.001)" in section.answer


@pytest.mark.parametrize(
    "bad",
    [
        "<svg><script>1</script></svg>", '<svg onload="x"/>', "<svg><a href='x'/></svg>",
        '<svg><g><path onClick="x"/></g></svg>', "<svg><image href='#a'/></svg>",
        "<svg><use href='other.svg#a'/></svg>", "<svg><foreignObject/></svg>",
        '<svg xmlns:l="http://www.w3.org/1999/xlink"><use l:href="javascript:x"/></svg>',
        '<s:svg xmlns:s="http://www.w3.org/2000/svg"><s:script/></s:svg>',
        '<svg><p:script xmlns:p="http://www.w3.org/1999/xhtml"/></svg>',
        '<svg><path style="fill: url(http://x)"/></svg>', "<svg><style>@import 'x'</style></svg>",
        '<svg><set attributeName="href" to="x"/></svg>',
    ],
)  # fmt: skip
def test_a_drawing_that_could_run_something_is_refused(bad: str) -> None:
    with pytest.raises(ValueError, match="must not hold"):
        inline_svg(bad, "k", "label")


def test_a_drawing_that_is_cut_off_is_named() -> None:
    with pytest.raises(ValueError, match="figure k: expected an SVG element"):
        inline_svg("<svg><g></svg>", "k", "label")


def test_elements_and_attributes_are_made_the_pages_and_text_stays() -> None:
    text = 'gas only = CO2 id="x" d="1.23456" url(#a) href="#a" fill: #1b1b1b &lt;script&gt;'
    drawing = (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        'width="9pt" height="8pt"><metadata><x/></metadata><g id="a" clip-path="url(#a)"/>'
        '<path d="M 1.25 2.449&#10;L 3 4.06"/>'
        f'<use xlink:href="#a" style="fill: #1b1b1b"/><text fill="#1b1b1b">{text}</text></svg>'
    )
    found = inline_svg(drawing, "k", 'a "label" <b>')
    assert f">{text}</text>" in found
    assert '<g id="k-a" clip-path="url(#k-a)" />' in found
    assert '<use xlink:href="#k-a" style="fill: var(--f-1b1b1b, #1b1b1b)" />' in found
    assert '<text fill="var(--f-1b1b1b, #1b1b1b)">' in found
    assert found.startswith(
        '<svg role="img" aria-label="a &quot;label&quot; &lt;b&gt;" style="--made: 9pt" '
    )
    assert '<path d="M 1.2 2.4 L 3 4.1" />' in found
    assert "metadata" not in found and "8pt" not in found


ODD = (
    "gas only = CO2", "onload=x", "\"CO2\" it's", "<b>&amp;</b> &", "javascript:1", 'href="#x"',
    'id="y" d="1.234"', "url(#a)", "fill: #1b1b1b", "{a} {{}} {0}", "%s 100 % %(x)d", "$x^2$ \\a",
    "Ω 气 🧪 e\u0301", "\ue000fit\ue001", "a\uffffb", "--> ]]> <!--", "[1] a[b]", "../../etc",
    "| *b* `c` # _d_", "#let x = @a", "x" * 500,
)  # fmt: skip
"""names that some language takes for its own"""


@pytest.mark.slow
def test_names_that_mean_something_elsewhere_are_only_names_here(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = 'title = "odd = 1"\n' + "".join(
        f"[[experiment]]\nname = {json.dumps(name, ensure_ascii=False)}\n"
        f'carrier_flow = "{4 + k % 5} L/min"\ntest_gas_flow = "0.5 L/min"\ncommanded_on = "2 s"\n'
        'interval = "50 ms"\nduration = "12 s"\n'
        for k, name in enumerate(ODD)
    )
    (tmp_path / "design.toml").write_text(text, encoding="utf-8")
    (tmp_path / "few.toml").write_text("[fit]\nswarms = 1\nparticles = 6\neuler = false\n")
    data, out = tmp_path / "data", tmp_path / "out"
    assert run("simulate", "--design", tmp_path / "design.toml", "--out", data, "--quiet") == 0
    options = ["--config", tmp_path / "few.toml", "--out", out, "--quiet"]
    assert run("fit", data / "campaign.toml", *options) in (0, 3)
    for form in ("html", "pdf"):
        assert run("report", out, "--format", form, "--quiet") == 0
    assert "error" not in capsys.readouterr().err
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    assert page.open == []
    for _, attributes in page.tags:
        assert not [a for a in attributes if a.startswith("on")]
        assert (attributes.get("href") or "#").startswith(("#", "data:"))
    for name in ODD:
        assert sum(("td", name) == text or ("th", name) == text for text in page.texts) >= 3, name
    where = [{"experiment": name, "phase": "rise", "excess_rms_V": 1e-3, "share": 0.1,
              "p_value": 0.5} for name in ODD]  # fmt: skip
    drawing = figures.svg(figures.gap_where(where))
    labels = ["".join(element.itertext()) for element in ElementTree.fromstring(drawing).iter()]
    page = Page(inline_svg(drawing, "k", "label"))
    for name in ODD:
        shown = name.replace("\uffff", "\ufffd")  # which XML does not know
        assert (shown if len(name) <= 18 else name[:17] + "…") in labels, name
        if len(name) <= 18:
            assert ("text", shown) in page.texts, name


# --- a report that fails


@pytest.fixture
def short_analyze(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str | Path]:
    """The arguments of an ``analyze`` that fits and reports, into ``tmp_path / "out"``."""
    for table in (job.STEPS, job.SAVES):
        monkeypatch.setitem(table, "analyze", ("fit", "residuals", "report"))
    options = ["--experiments", "1,4", "--duration", "15 s", "--interval", "20 ms", "--quiet"]
    assert run("simulate", "--out", tmp_path / "data", *options) == 0
    campaign = tmp_path / "data" / "campaign.toml"
    return ["analyze", campaign, "--out", tmp_path / "out", "--quiet"]


@pytest.mark.parametrize(
    ("failure", "code", "said"),
    [
        (CampaignError("traces.npz: bad"), 2, "the report was not made: traces.npz: bad; "),
        (
            OSError(28, "No space left on device", "a.svg"),
            2,
            r"a\.svg: .*\(No space left on",
        ),
        (ValueError("unforeseen"), None, "error: the report was not made; "),
        (KeyboardInterrupt(), 130, "stopped: interrupted"),
    ],
)
def test_a_report_that_fails_leaves_all_other_results(
    short_analyze: list[str | Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    failure: BaseException,
    code: int | None,
    said: str,
) -> None:
    def fails(*arguments: Any) -> None:
        raise failure

    with monkeypatch.context() as patch:
        patch.setattr(report, "write_report", fails)
        if code is None:
            with pytest.raises(ValueError, match="unforeseen"):
                run(*short_analyze)
        else:
            assert run(*short_analyze) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and re.search(said, error)
    out = tmp_path / "out"
    if code != 130:
        again = f"all other results are in place, and bayes-sensor report {out} makes it"
        assert again in error
    names = {p.name for p in out.iterdir()}
    assert names == {"campaign.json", "fit.json", "residuals.json", "run.json", "samples.npz",
                     "traces.npz", "campaign_record.npz", "fit_record.npz",
                     "residuals_record.npz"}  # fmt: skip
    assert json.loads((out / "run.json").read_text())["commands"]["analyze"]["exit_code"] == 0
    assert run("report", out, "--quiet") == 0
    assert "How well does the model fit" in (out / "report.html").read_text(encoding="utf-8")


def test_analyze_takes_what_the_report_shall_hold(
    short_analyze: list[str | Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*short_analyze, "--pages", "long") == 2
    error = capsys.readouterr().err
    assert "--pages long" in error and "short, full" in error and error.count("\n") == 1
    assert not (tmp_path / "out" / "fit.json").exists()
    assert run(*short_analyze, "--no-figures", "--pages", "full") == 0
    out = tmp_path / "out"
    assert {p.name for p in (out / "figures").iterdir()} == {"chain.svg"}
    assert '<details class="section" id="fit" open>' in (out / "report.html").read_text()


def test_table_cells_are_rounded_but_sort_by_the_full_value() -> None:
    cell = Table("k", "c", ["x"], [[0.123456789]]).cells([0.123456789])[0]
    assert cell == {"text": "0.1235", "full": "0.123456789", "num": True}
    assert Table("k", "c", ["x"], []).cells([None, True, "a"])[0]["text"] == "–"
    small = Table("k", "c", ["p"], [[p_value(1e-30)], [to_spread(48.1234, 12.0)]])
    assert small.numeric == [True]
    assert small.cells(small.rows[0]) == [{"text": "below 0.001", "full": "1e-30", "num": True}]
    assert small.cells(small.rows[1])[0]["text"] == "48"


def test_a_strength_has_its_unit_and_no_second_one_in_its_name() -> None:
    units = {"closing_ratio": "1", "mains_V": "ppm", "filter": "s", "late_rise": "s"}
    said = strength_words({"closing_ratio": 1.1, "mains_V": 0.01, "filter": 0.015, "s": 2}, units)
    assert said == "closing ratio = 1.10, mains = 0.0100 ppm, filter = 0.0150 s, s = 2.00"
    assert (
        strength_words({"mains_V": 8e-6, "mains_Hz": 150.0}, {"mains_V": "V", "mains_Hz": "Hz"})
        == "mains amplitude = 8.00 × 10⁻⁶ V, mains frequency = 150 Hz"
    )
    assert (
        strength_words({"late_rise": {"1": 0.1, "2": 0.3}}, units) == "late rise = 0.100 to 0.300 s"
    )


# --- the page


class Page(HTMLParser):
    """Tags, ids, links and texts of a page, with a check that what is opened is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "img", "br", "input"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((self.open[-1] if self.open else "", data))


@pytest.mark.parametrize("pages", PAGES)
def test_page_is_whole_self_contained_and_in_order(
    analysed: Path, whole: Report, pages: str
) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    if pages == "full":
        text = html.page(whole)
    assert len(text) < 15e6
    page = Page(text)
    assert page.open == []
    for tag, attributes in page.tags:
        for key in ("src", "href", "xlink:href"):
            target = attributes.get(key) or "#"
            assert target.startswith(("#", "data:")), f"<{tag} {key}={target}>"
    assert not re.search(r"url\((?!#)", text), "a style refers to something outside"
    ids = [a["id"] for _, a in page.tags if "id" in a]
    assert len(ids) == len(set(ids))
    anchors = {a["href"] for t, a in page.tags if t == "a"}
    assert anchors <= {f"#{i}" for i in ids}
    titles = re.findall(r"<summary><h2 id=.*?</span> (.*?)</h2></summary>", text)
    folds = [a for t, a in page.tags if t == "details" and a.get("class") == "section"]
    assert len(folds) == len(titles) and all(("open" in a) == (pages == "full") for a in folds)
    assert [t for t in titles if t in ORDER] == [t for t in ORDER if t in titles]
    assert set(titles) <= set(ORDER) and {*ORDER[:4], *ORDER[-1:]} <= set(titles)
    pictures = [a for t, a in page.tags if t == "figure" and a.get("class") == "picture"]
    assert sum("data-trace" in a for a in pictures) == 4
    assert all(a.get("aria-label") for t, a in page.tags if t == "svg")
    undrawn = [f for f in re.findall(r'<div class="drawing">(.*?)</div>', text, re.DOTALL)
               if "<svg" not in f]  # fmt: skip
    # the page draws overlays from its samples; draws of the posterior are left to paper
    assert len(undrawn) == (0 if pages == "full" else 3 + 2)


def test_every_answer_with_a_number_points_to_its_table(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    answers = re.findall(r'<p class="answer">(.*?)</p>', text, re.DOTALL)
    assert len(answers) >= 6
    for answer in answers:
        words = re.sub(r"<.*?>", "", answer)
        if re.search(r"\d", words):
            assert 'class="see" href="#' in answer, words


def test_hostile_names_stay_text(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    runs = [a for tag, a in page.tags if tag == "script" and a.get("type") is None]
    data = [a for tag, a in page.tags if tag == "script" and a.get("type") is not None]
    assert len(runs) == 2 and len(data) == 4  # tables, zoom; samples of each experiment
    assert "document.title='taken'</script>" not in text
    assert "&lt;script&gt;document.title=" in text
    assert not any("script" in p.name for p in (analysed / "figures").iterdir())


@pytest.mark.slow
def test_figures_are_saved_once_as_vectors_and_on_demand_as_pixels(
    analysed: Path, tmp_path: Path
) -> None:
    always = {"chain", "histogram", "autocorrelation", "spread", "delays", "intervals",
              "predictive", "responses"}  # fmt: skip
    names = {p.name for p in (analysed / "figures").iterdir()}
    assert {f"{stem}.svg" for stem in always} <= names
    assert {p.rpartition(".")[2] for p in names} == {"svg"}
    assert sum(name.startswith("overlay") for name in names) == 1
    assert not {"corner.svg", "traces.svg", "step_study.svg"} & names
    out = shutil.copytree(analysed, tmp_path / "out")
    bounds = json.loads((out / "bounds.json").read_text())
    (out / "bounds.json").write_text(json.dumps({**bounds, "step_study": STUDY}))
    options = ["--pages", "full", "--png", "--jobs", "2", "--compare-published", "--quiet"]
    assert run("report", out, *options) == 0
    names = {p.name for p in (out / "figures").iterdir()}
    for stem in (*always - {"chain"}, "overlay_1", "overlay_4", "corner", "traces", "step_study"):
        assert {f"{stem}.svg", f"{stem}.png"} <= names
        assert imread(out / "figures" / f"{stem}.png")[..., :3].std() > 0.02, stem
    assert run("report", out, "--no-figures", "--quiet") == 0
    assert {p.name for p in (out / "figures").iterdir()} == {"chain.svg"}
    text = (out / "report.html").read_text(encoding="utf-8")
    assert text.count('<figure class="picture"') == 1 and "<table" in text
    assert run("report", out, "--pages", "three") == 2


def test_numbers_of_the_page_are_those_of_the_files(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    posterior = json.loads((analysed / "posterior.json").read_text())
    tau = posterior["parameters"]["tau_s"]
    fit = json.loads((analysed / "fit.json").read_text())
    assert f'data-v="{1e3 * tau["mean"]!r}"' in text
    assert f'data-v="{fit["parameters"]["V_mL"]!r}"' in text
    assert f"RMS residual of {number(1e3 * fit['rms_V'])} mV" in text
    lo, hi = (1e3 * tau[k] for k in ("q2.5", "q97.5"))
    assert f"[{with_spread(lo, hi - lo)}, {with_spread(hi, hi - lo)}] ms" in text
    run_file = json.loads((analysed / "run.json").read_text())["commands"]["analyze"]
    for name, value in run_file["files_sha256"].items():
        assert name in text and value in text


def test_report_is_rebuilt_from_saved_results_alone(analysed: Path, tmp_path: Path) -> None:
    page = write_report(analysed, tmp_path).read_text(encoding="utf-8")
    assert page == (analysed / "report.html").read_text(encoding="utf-8")
    names = {p.name for p in (tmp_path / "figures").iterdir()}
    assert names == {p.name for p in (analysed / "figures").iterdir()}


@pytest.mark.slow
def test_a_report_loads_nothing_that_computes(analysed: Path, tmp_path: Path) -> None:
    slow = ("numba", "scipy", "pandas", "arviz", "statsmodels", "corner")
    code = (
        "import sys; from bayes_sensor.report import write_report; "
        f"write_report({str(analysed)!r}, {str(tmp_path)!r}); "
        f"print([m for m in {slow} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_result_that_cannot_be_read_is_named_and_nothing_is_lost(
    analysed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("campaign.json", "run.json"):
        shutil.copy(analysed / name, tmp_path / name)
    (tmp_path / "report.html").write_text("the earlier report")
    for name, content, said in (
        ("posterior.nc", b"\x89HDF\r\n\x1a\n cut off", "expected the draws"),  # only in full
        ("samples.npz", b"PK\x03\x04 cut off", "expected saved samples"),
        ("gap.json", b"{", "cannot be read"),
    ):
        (tmp_path / name).write_bytes(content)
        if name == "posterior.nc":
            shutil.copy(analysed / "posterior.json", tmp_path / "posterior.json")
        assert run("report", tmp_path, "--pages", "full") == 2
        error = capsys.readouterr().err
        assert f"{name}: expected" in error and said in error
        (tmp_path / name).unlink()
    assert (tmp_path / "report.html").read_text() == "the earlier report"


def test_parts_that_were_not_computed_are_left_out(analysed: Path, tmp_path: Path) -> None:
    for name in ("campaign.json", "run.json", "fit.json", "traces.npz"):
        shutil.copy(analysed / name, tmp_path / name)
    text = write_report(tmp_path, tmp_path).read_text(encoding="utf-8")
    assert "How well does the model fit" in text
    assert "time constant</h2>" not in text and 'id="delays"' not in text


def test_what_failed_stands_at_the_top(analysed: Path, tmp_path: Path) -> None:
    for name in ("campaign.json", "run.json", "fit.json", "traces.npz", "posterior.json"):
        shutil.copy(analysed / name, tmp_path / name)
    for name, change in (
        ("fit.json", {"converged": False, "status": "The refinement stopped."}),
        ("posterior.json", {"converged": False, "status": "largest R-hat 1.2 (tau_s)"}),
    ):
        content = json.loads((tmp_path / name).read_text())
        (tmp_path / name).write_text(json.dumps({**content, **change}))
    record = json.loads((tmp_path / "run.json").read_text())
    record["commands"]["fit"] = {**record["commands"]["analyze"], "basis_sha256": "other"}
    (tmp_path / "run.json").write_text(json.dumps(record))
    found = [text for kind, text in alerts(read_results(tmp_path)) if kind == "bad"]
    assert len(found) == 3
    assert "did not converge" in found[0] and "must not be quoted" in found[1]
    assert "fit rest on other data" in found[2]
    page = write_report(tmp_path, tmp_path).read_text(encoding="utf-8")
    assert page.index("must not be quoted") < page.index('class="big"')


@pytest.mark.parametrize("missing", ["campaign.json", "run.json"])
def test_a_folder_without_results_is_refused(analysed: Path, tmp_path: Path, missing: str) -> None:
    for name in {"campaign.json", "run.json"} - {missing}:
        shutil.copy(analysed / name, tmp_path / name)
    with pytest.raises(CampaignError, match="expected a results folder"):
        read_results(tmp_path)


@pytest.mark.slow
def test_overlays_are_left_out_before_the_page_grows_too_large(
    analysed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved = read_results(analysed)
    assert saved.traces is not None
    # without samples the page cannot draw them itself
    made = drawn(replace(saved, traces=saved.traces[:3], samples=None), "short")
    text = html.page(made)
    assert "Drawn in figures/overlay_3.svg" not in text and html.WHEN_OPENED not in text
    assert html.MOST_VECTORS + html.MOST_SAMPLES < 13e6  # 2 MB for the rest
    monkeypatch.setattr(html, "MOST_VECTORS", 60_000)
    assert "Drawn in figures/overlay_3.svg" in html.page(made)


def test_samples_of_fifty_experiments_stay_within_their_budget(analysed: Path) -> None:
    saved = read_results(analysed)
    assert saved.samples is not None and saved.traces is not None
    rng = np.random.default_rng(3)
    n = 120_000
    noise = np.rint(16 * rng.standard_normal(n)).astype(np.int64)  # as large as samples get
    long = replace(saved.samples[0], runs=np.array([(0, n, 1)]), values=noise, interval=1e-3)
    few = replace(saved, samples=[long] * 2, traces=saved.traces[:1] * 2)
    assert not any(each["thinned"] for each in zoom_data(few))
    many = zoom_data(replace(saved, samples=[long] * 60, traces=saved.traces[:1] * 60))
    assert all(each["thinned"] for each in many)
    total = sum(len(json.dumps(each)) for each in many)
    assert 0.5 * html.MOST_SAMPLES < total < 1.3 * html.MOST_SAMPLES


# --- the gap, from a saved diagnosis


def diagnosis(saved_names: list[str]) -> dict[str, Any]:
    """A gap.json of the contract's form, with a hostile experiment name among its rows."""
    phases = ("baseline", "onset", "rise", "plateau", "fall", "tail")
    where = [
        {"experiment": name, "phase": phase, "t_start_s": float(i), "t_end_s": i + 1.0,
         "excess_rms_V": 0.004 if phase == "fall" else 0.0,
         "share": 1 / len(saved_names) if phase == "fall" else 0.0,
         "p_value": 0.001 if phase == "fall" else 0.6}
        for name in saved_names for i, phase in enumerate(phases)
    ]  # fmt: skip
    which = [
        {"effect": e, "family": f, "probability": p, "d": d, "strength": {"fraction": 0.98},
         "tau_s": 0.05, "fraction_closed": 0.9, "confusable_with": ["valve_asymmetry"]}
        for e, f, p, d in (
            ("none", None, 0.01, None), ("flow_switching", "asymmetry", 0.95, 12.0),
            ("unlisted", None, 0.03, None), ("valve_asymmetry", "asymmetry", 0.01, 11.0),
        )
    ]  # fmt: skip
    return {
        "budget": {"calibrated_rms_V": 0.0654, "noise_floor_rms_V": 0.0652, "excess_rms_V": 0.004,
                   "excess_d": 12.2, "p_value": 1e-6, "nominal_rms_V": 0.09},
        "where": where,
        "which": which,
        "verdict": {"kind": "effect", "effects": ["flow_switching"], "family": "asymmetry",
                    "probability": 0.95, "sentence": "The fall is slower than the rise."},
        "shrink": {"before_excess_rms_V": 0.004, "after_excess_rms_V": 0.0005,
                   "fraction_closed": 0.97, "fraction_closed_lo": 0.9, "fraction_closed_hi": 1.02,
                   "held_out_fraction_closed": 0.93, "tau_before_s": 0.05, "tau_after_s": 0.046,
                   "withheld": False},
        "hidden": {"lag": "tau",
                   "effects": [{"effect": "daq_filter", "d": 0.05, "tau_shift_s": 0.0025},
                               {"effect": "dead_volume", "d": 5.0, "tau_shift_s": -0.04},
                               {"effect": "heavy_tails", "d": None, "tau_shift_s": 0.0}],
                   "tau_envelope_s": [0.02, 0.11]},
    }  # fmt: skip


def told_more(record: dict[str, Any]) -> None:
    """What a diagnosis says beyond the contract."""
    record["families"] = {"asymmetry": 0.96}
    record["where_left_out_d"] = {"rise": 2.0, "fall": 30.0, "tail": None}
    record["shrink"] |= {"tau_after_lo_s": 0.03, "tau_after_hi_s": 0.06, "rival": "dead_volume",
                         "rival_fraction_closed": 0.41}  # fmt: skip
    record["which"][1]["strength"] = {"flow_factor": {"1": 0.99, "2": 1.02}}
    for row in record["hidden"]["effects"]:
        row.update(strength={"x": 1.0}, tau_with_it_s=0.05, tau_low_s=0.04, tau_high_s=0.06,
                   contradicted=row["effect"] == "dead_volume")  # fmt: skip
    record["rounds"] = [{"added": ["flow_switching"], "probability": 0.95, "d_left": 3.0,
                         "p_left": 0.4, "unlisted_left": False}]  # fmt: skip
    record["separate"] = [{"effect": "flow_switching", "rival": "valve_asymmetry",
                           "isolability": 2.0, "addition": "a second carrier flow",
                           "isolability_with_it": 6.0}]  # fmt: skip
    record["full_rate"] = [{"name": "mains_pickup", "log_bayes_factor": -2.0, "probability": 0.01,
                            "strength": {"mains_V": 0.001}, "d": 1.0}]  # fmt: skip
    record["residuals"] = [
        {"experiment": row, "since_switch_s": [-1.0, 0.1, 1.0, 5.0],
         "whitened": [0.3, -1.0, 4.0, 0.2], "phase": [0, 1, 2, 5]} for row in (HOSTILE, "1")
    ]  # fmt: skip
    record["notes"] = ["only a note"]
    record["budget"] |= {"p_value": 0.003, "p_value_of_size": 0.3, "p_value_of_form": 0.001}
    record["where_shared_by"] = "explanations"


@pytest.mark.parametrize("change", ["effect", "more", "none"])
def test_the_gap_is_told_when_it_was_diagnosed(analysed: Path, tmp_path: Path, change: str) -> None:
    for name in ("campaign.json", "run.json"):
        shutil.copy(analysed / name, tmp_path / name)
    record = diagnosis([HOSTILE, "1", "2"])
    if change == "none":  # nothing found: what cannot be said is null
        record["verdict"] = {"kind": "none", "effects": [], "family": None, "probability": 0.8,
                             "sentence": "No gap beyond the noise was found."}  # fmt: skip
        record["shrink"] = dict.fromkeys(record["shrink"], None) | {"withheld": True}
        record["budget"] |= {"nominal_rms_V": None, "p_value": None}  # as without a bootstrap
        record["hidden"]["tau_envelope_s"] = [None, None]
        for row in record["where"]:
            row.update(share=0.0, excess_rms_V=0.0, p_value=None)
    if change == "more":
        told_more(record)
    (tmp_path / "gap.json").write_text(json.dumps(record))
    text = write_report(tmp_path, tmp_path, Choice(png=True)).read_text(encoding="utf-8")
    assert Page(text).open == [] and HOSTILE not in text
    assert record["verdict"]["sentence"].removesuffix(".") in text
    for name in ("gap-where", "gap-which", "gap-hidden"):
        assert imread(tmp_path / "figures" / f"{name}.png")[..., :3].std() > 0.02
    if change == "more":
        for said in (
            "A fit to all other phases predicts the fall worst", "(95 % interval 30.0 to 60.0 ms)",
            "The best rival outside the family, dead volume, closes 41 %", "Only a note.",
            "With flow switching in the model, d = 3.00 is left",
            "To tell flow switching from valve asymmetry: a second carrier flow",
            "flow factor = 0.990 to 1.02", "no: contradicted by the data",
            "By its size that is no more than noise alone would leave, but along the course of a",
            "= 0.001 for the largest of all courses", "p-value of the largest listed course",
            "Shades and shares are what the explanations put there", "p-values are measured.",
        ):  # fmt: skip
            assert said in text, said
        assert imread(tmp_path / "figures" / "gap-residuals.png")[..., :3].std() > 0.02
    else:
        assert "By its size" not in text and "Without a frame a shade is no more" in text
    if change != "none":
        assert "97 % of the gap closes (95 % interval 90 to 102 %)" in text
        assert "93 % on data that were left out" in text
        assert "τ lies between 20 and 110 ms" in text
    else:
        assert "no fraction of it can be said to close" in text and "p not computed" in text


def test_both_posteriors_of_tau_are_shown(analysed: Path, tmp_path: Path) -> None:
    for name in ("campaign.json", "run.json", "posterior.json"):
        shutil.copy(analysed / name, tmp_path / name)
    record = json.loads((analysed / "posterior.json").read_text())
    shutil.copy(analysed / "posterior.json", tmp_path / "posterior_without_effects.json")
    record["with_effects"] = ["flow_switching"]
    record["parameters"]["tau_s"]["q50"] *= 1.5
    (tmp_path / "posterior.json").write_text(json.dumps(record))
    text = write_report(tmp_path, tmp_path).read_text(encoding="utf-8")
    assert "AR(1) noise; with flow switching in the model)" in text
    rows = re.search(r'<table id="table-both-posteriors">.*?</table>', text, re.DOTALL)
    assert rows is not None
    medians = [float(v) for v in re.findall(r'data-v="([\d.e-]+)"', rows[0])[2::5]]
    assert medians[1] == pytest.approx(1.5 * medians[0])


# --- other formats


def test_what_points_nowhere_is_left_out() -> None:
    text = "A" + see("gone") + " and B" + see("here", "gone") + "."
    found = "".join(piece for piece, _ in pieces(text, {"here": "Table 1"}))
    assert found == "A and B (Table 1)."
    with pytest.raises(ValueError, match="two parts"):
        numbering([Table("k", "c", [], [])] * 2)


@pytest.mark.slow
@pytest.mark.parametrize("pages", PAGES)
def test_the_report_as_markdown(analysed: Path, tmp_path: Path, pages: str) -> None:
    out = shutil.copytree(analysed, tmp_path / "out")
    assert run("report", out, "--format", "md", "--pages", pages, "--quiet") == 0
    text = (out / "report.md").read_text(encoding="utf-8")
    assert "<script" not in text and "&lt;script&gt;" in text
    tags = set(re.findall(r"<[^>]*>", text))
    assert all(re.fullmatch(r'<a id="[\w-]+">|</a>', tag) for tag in tags), tags
    anchors = set(re.findall(r'<a id="([\w-]+)">', text))
    assert set(re.findall(r"\]\(#([\w-]+)\)", text)) <= anchors
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", text):
        assert (out / picture).is_file()
    for block in re.findall(r"(?:^\|.*\|$\n)+", text, re.MULTILINE):
        widths = {len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}
        assert len(widths) == 1, block[:200]
    assert ("Table" in text) == (pages == "full")


def test_text_in_markdown_is_no_markup() -> None:
    assert escaped("https://a.b www.c.d e@f.g :h:") == r"https\://a.b www\.c.d e\@f.g \:h:"
    assert escaped("*a* [b](c) `d`") == r"\*a\* \[b\](c) \`d\`"
    assert escaped("- x\n1. y") == r"\- x 1. y"
    assert escaped("<img src=x>") == "&lt;img src=x&gt;"


@pytest.fixture
def paper(monkeypatch: pytest.MonkeyPatch) -> Callable[[Report], list[Any]]:
    """What gives the pages of a PDF as pictures."""
    import typst

    compiled = typst.compile

    def pages_of(made: Report) -> list[Any]:
        pages: list[bytes] = []

        def as_pictures(*arguments: Any, **options: Any) -> bytes:
            found = compiled(*arguments, **options, format="png", ppi=40)
            pages.extend(found if isinstance(found, list) else [found])
            return b""

        with monkeypatch.context() as patch:
            patch.setattr(typst, "compile", as_pictures)
            pdf.document(made)
        return [imread(io.BytesIO(page))[..., :3].min(axis=-1) < 0.8 for page in pages]

    return pages_of


def test_the_report_as_pdf(saved: Saved) -> None:
    content = pdf.document(drawn(saved, "short", folded=False))
    assert content.startswith(b"%PDF") and content.rstrip().endswith(b"%%EOF")


def test_the_answer_is_on_two_pages(saved: Saved, paper: Callable[[Report], list[Any]]) -> None:
    made = drawn(saved, "short", folded=False)
    assert [picture.key for picture in made.pictures()][:1] == ["chain"]
    assert len(list(made.pictures())) == 2
    assert len(paper(made)) == 2
    keys = {section.key for _, section in made.listed}
    assert "tau" not in keys and "noise" not in keys and {"measured", "computed"} <= keys


def test_a_section_has_one_number_in_every_format(saved: Saved) -> None:
    page = html.page(assemble(saved))
    made = assemble(saved, folded=False)
    made.first.facts.append(Fact("Model right?", "No.", "gap"))
    text = markdown.document(made)
    numbered = re.findall(r"^## (\d+)\. (.*)$", text, re.MULTILINE)
    assert len(numbered) > 3 and int(numbered[-1][0]) > len(numbered)
    for i, title in numbered:
        assert f'<span class="count">{i}</span> {title}</h2>' in page
    assert "**Model right?** No." in text


def test_the_time_of_the_chain_is_told_once_for_one_flow(saved: Saved) -> None:
    assert saved.coating is not None
    rows = saved.coating["response_times"]
    chain = next(row for row in rows if row["system"].startswith("chain"))
    one = {**saved.coating, "response_times": [*rows, chain]}
    answers = [
        section.answer
        for section in assemble(replace(saved, coating=one)).sections
        if section.key == "coating"
    ]
    assert [answer.count(" L/min") for answer in answers] == [1]


def test_no_page_on_paper_is_left_half_empty_and_nothing_stands_in_the_margin(
    whole: Report, paper: Callable[[Report], list[Any]]
) -> None:
    columns = [f"a long name of column {k}" for k in range(12)]
    row = ["some words that take room", *(123.456 * k for k in range(11))]
    wide = Table("wide", "Words and numbers.", columns, [row] * 3)
    sections = [*whole.sections, Section("more", "More", "See.", [], [wide])]
    pages = paper(replace(whole, sections=sections))
    assert 6 < len(pages) <= 40
    for page_number, inked in enumerate(pages, 1):
        n_rows, n_columns = inked.shape
        # the margins are 19 mm of 210; glyphs may overhang by a hair
        edge = int((19.0 - 1.0) / 210.0 * n_columns)
        assert not inked[:, :edge].any() and not inked[:, -edge:].any(), page_number
        if page_number == len(pages):
            break
        # between the margins, without the footer
        body = inked[int(0.05 * n_rows) : int(0.92 * n_rows)].any(axis=1)
        foot = 1.0 - (np.flatnonzero(body)[-1] + 1) / len(body)
        assert foot < 1 / 3, (page_number, foot)


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_is_written_by_the_command(
    analysed: Path, tmp_path: Path, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("campaign.json", "run.json"):
        shutil.copy(analysed / name, tmp_path / name)
    assert run("report", tmp_path, "--format", form) == 0
    assert FORMATS[form] in capsys.readouterr().out
    assert (tmp_path / FORMATS[form]).stat().st_size > 500
    assert {p.name for p in tmp_path.iterdir()} == {
        "campaign.json", "run.json", "figures", FORMATS[form],
    }  # fmt: skip


def test_an_unknown_format_is_refused(analysed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("report", analysed, "--format", "docx") == 2
    error = capsys.readouterr().err
    assert "--format docx" in error and "html, pdf, md" in error and error.count("\n") == 1


# --- in a browser

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome", "chrome")
     if (path := shutil.which(name))),
    None,
)  # fmt: skip
PROBE = """
<script>
window.addEventListener("load", function () {
  var out = {};
  var folds = document.querySelectorAll("details.section");
  out.folded = folds.length;
  location.hash = "t-experiments";
  setTimeout(function () {
  out.revealed = document.getElementById("t-experiments").getBoundingClientRect().height > 50;
  folds.forEach(function (d) { d.open = true; });
  var table = document.getElementById("table-experiments");
  var button = Array.prototype.find.call(table.querySelectorAll("button.sort"), function (b) {
    return b.textContent.indexOf("flow") === 0; });
  button.click(); button.click();
  out.flows = Array.prototype.map.call(table.tBodies[0].rows, function (r) {
    return Number(r.cells[4].getAttribute("data-v")); });
  out.sorted = button.closest("th").getAttribute("aria-sort");
  var drawings = document.querySelectorAll(".drawing > svg");
  out.empty = 0;
  drawings.forEach(function (d) {
    var box = d.getBoundingClientRect();
    if (box.width < 100 || box.height < 50) { out.empty += 1; } });
  out.n = drawings.length;
  out.wide = document.documentElement.scrollWidth > window.innerWidth + 1;
  out.ready = document.documentElement.dataset.ready; out.title = document.title;

  // the zoom of the second experiment
  var figure = document.querySelector('figure[data-trace="1"]');
  if (!figure.querySelector("canvas")) { figure.querySelector("button.opener").click(); }
  var canvas = figure.querySelector("canvas"), words = figure.querySelector(".readout");
  var box = canvas.getBoundingClientRect();
  function view() { return [Number(canvas.dataset.from), Number(canvas.dataset.to)]; }
  function later(act) { setTimeout(act, 150); }
  function press(key) {
    canvas.dispatchEvent(new KeyboardEvent("keydown",
      { key: key, bubbles: true, cancelable: true }));
  }
  out.whole = view(); out.all = words.textContent;
  var paint = canvas.getContext("2d"), seen = {};
  var pixels = paint.getImageData(0, 0, canvas.width, canvas.height).data;
  for (var i = 0; i < pixels.length; i += 4) {
    if (pixels[i + 3] > 200) { seen[pixels[i] + "," + pixels[i + 1] + "," + pixels[i + 2]] = 1; }
  }
  out.colours = Object.keys(seen).length;
  canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -300, clientX: box.left + 0.5 * box.width,
    clientY: box.top + 40, cancelable: true }));
  later(function () {
    out.wheel = view(); press("+");
    later(function () {
      out.plus = view(); press("ArrowRight");
      later(function () {
        out.right = view();
        for (var k = 0; k < 40; k += 1) { press("+"); }
        later(function () {
          out.closest = view();
          canvas.dispatchEvent(new PointerEvent("pointermove", { pointerId: 1,
            clientX: box.left + 0.5 * box.width, clientY: box.top + 40 }));
          out.words = words.textContent; press("Home");
          later(function () {
            out.home = view(); press("Escape");
            out.closed = figure.querySelector("canvas") === null
              && figure.querySelector(".drawing").getBoundingClientRect().width > 100;
            var pre = document.createElement("pre");
            pre.id = "probe"; pre.textContent = JSON.stringify(out);
            document.body.appendChild(pre);
          });
        });
      });
    });
  });
  }, 100);
});
</script></body>"""


def browse(profile: Path, page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert BROWSER is not None
    return subprocess.run(
        [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", "--disable-dev-shm-usage", "--hide-scrollbars",
            "--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr",
            f"--user-data-dir={profile}", *options, page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip


@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed: the page is not opened")
@pytest.mark.parametrize("width", [420, 1200])
def test_page_lives_in_a_browser(analysed: Path, tmp_path: Path, width: int) -> None:
    page = tmp_path / "page.html"
    text = (analysed / "report.html").read_text(encoding="utf-8")
    page.write_text(text.replace("</body>", PROBE), encoding="utf-8")
    done = browse(tmp_path / "p1", page, "--dump-dom", "--virtual-time-budget=3000",
                  f"--window-size={width},2000")  # fmt: skip
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert console == []
    found = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout)
    assert found is not None, done.stderr[-2000:]
    probe = json.loads(found[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    assert probe["ready"] == "yes" and probe["title"] != "taken"
    assert probe["folded"] >= 8 and probe["revealed"]
    assert probe["n"] >= 10 and probe["empty"] == 0 and not probe["wide"]
    assert probe["flows"] == sorted(probe["flows"], reverse=True)
    assert probe["sorted"] == "descending"

    # the zoom shows the samples that were saved
    samples = load_samples(analysed / "samples.npz")[1]
    t, y = samples.t, samples.offset + samples.step * samples.values
    assert probe["whole"] == pytest.approx([t[0], t[-1]])
    assert f"{len(t)} samples" in probe["all"]
    assert probe["colours"] >= 5  # measurement, model, residual law, text, grid
    spans = {key: probe[key][1] - probe[key][0] for key in ("whole", "wheel", "plus", "right")}
    assert spans["wheel"] == pytest.approx(spans["whole"] * 1.0015**-300)
    assert spans["plus"] == pytest.approx(spans["wheel"] / 2)
    assert probe["right"][0] == pytest.approx(probe["plus"][0] + 0.2 * spans["plus"])
    assert probe["closest"][1] - probe["closest"][0] == pytest.approx(8 * samples.interval)
    shown = re.search(r"at ([\d.]+) s: measured ([\d.e+-]+) V", probe["words"])
    assert shown is not None, probe["words"]
    nearest = int(np.argmin(np.abs(t - float(shown[1]))))
    assert float(shown[2]) == pytest.approx(y[nearest], rel=6e-4)  # four digits are shown
    assert probe["home"] == pytest.approx(probe["whole"]) and probe["closed"]


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed: the page is not opened")
def test_page_is_seen_and_printed(analysed: Path, tmp_path: Path, whole: Report) -> None:
    page = analysed / "report.html"
    shot, paper = tmp_path / "page.png", tmp_path / "page.pdf"
    browse(tmp_path / "p1", page, f"--screenshot={shot}", "--window-size=1000,1400")
    pixels = imread(shot)[..., :3]
    bands = [band.std() for band in np.array_split(pixels, 10)]
    assert min(bands) > 0.01, "a tenth of the page is blank"
    browse(tmp_path / "p2", page, "--no-pdf-header-footer", f"--print-to-pdf={paper}")
    content = paper.read_bytes()
    n_pages = len(re.findall(rb"/Type\s*/Page\b", content))
    assert content.startswith(b"%PDF") and n_pages <= 2  # what is folded is not printed
    page = tmp_path / "full.html"
    page.write_text(html.page(whole), encoding="utf-8")
    browse(tmp_path / "p3", page, "--no-pdf-header-footer", f"--print-to-pdf={paper}")
    assert 8 <= len(re.findall(rb"/Type\s*/Page\b", paper.read_bytes())) <= 40


def test_every_colour_has_its_counterpart_in_the_dark(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    for colour in COLOURS:
        assert f"--f-{colour[1:]}:" in text


def test_what_the_noise_law_fails_in_stands_at_the_top_once_with_what_to_compare(
    saved: Saved,
) -> None:
    assert saved.residuals is not None and saved.bounds is not None
    assert saved.posterior is not None and saved.predictive is not None
    verdict = "The variance law fails; intervals are not to be trusted."
    residuals = {
        **saved.residuals, "adequate": False, "verdict": verdict,
        "recommendation": f"{TAKE_AS_THEY_ARE} Here these fail as well.",
    }  # fmt: skip
    doubt = f"{verdict} {residuals['recommendation']}"
    methods = saved.bounds["methods"]
    name = next(name for name in methods if name != "crlb_iid_one_percent_step")
    entry = {**methods[name], "status": f"the search ended early; {doubt}"}
    bounds = {**saved.bounds, "methods": {**methods, name: entry}}
    posterior = {**saved.posterior, "doubts": [doubt], "warnings": [doubt]}
    told = alerts(replace(saved, residuals=residuals, bounds=bounds, posterior=posterior))
    (kind, text), *others = [pair for pair in told if verdict in pair[1]]
    assert kind == "bad" and not others
    assert "the posterior, the profile and the Cramér-Rao bounds" in text
    assert text.endswith("Here these fail as well.")
    # the table of methods says what is wrong with each; here, with the one that is quoted
    assert not any("ended early" in note for _, note in told)
    alone = replace(saved, residuals=residuals, bounds={**bounds, "methods": {
        name: entry, "crlb_ar1": entry}}, posterior=None)  # fmt: skip
    quoted = [note for _, note in alerts(alone) if "ended early" in note]
    assert len(quoted) == 1 and doubt not in quoted[0]
    section = noise(replace(saved, residuals=residuals))
    assert section is not None and "Here these fail as well" in section.answer
    (table,) = [p for p in section.content if getattr(p, "key", "") == "noise-checks"]
    assert [row[-1] for row in table.rows] == ["passes"] * 4
    # replicates alone
    fine = {**saved.residuals, "adequate": True}
    failed = {**saved.predictive, "failed": ["pit_uniform"], "status": "Not alike: forecasts."}
    told = alerts(replace(saved, residuals=fine, predictive=failed))
    assert any(k == "bad" and t.startswith("Not alike") and TAKE_AS_THEY_ARE in t for k, t in told)


def test_what_decides_whether_the_headline_stands_comes_before_it_in_every_form(
    saved: Saved,
) -> None:
    caveat = "the noise is not what it seems"
    saved = replace(saved, fit={**(saved.fit or {}), "caveats": [caveat]})
    head = headline(saved.posterior, saved.bounds, saved.settings)
    assert head is not None
    said = escaped(typeset(head.text))
    page = html.page(assemble(saved))
    plain_page = markdown.document(assemble(saved, folded=False))
    told = "The noise is not what it seems"
    assert page.count(told) == plain_page.count(told) == 1
    assert page.index(told) < page.index('class="big"')
    assert plain_page.index(told) < plain_page.index(said)
    template = (files("bayes_sensor") / "templates" / "report.typ").read_text(encoding="utf-8")
    assert template.index("for alert in data.alerts") < template.index("[#data.tau]")


def test_a_remark_that_several_share_is_said_once(saved: Saved) -> None:
    def told(*texts: str) -> list[str]:
        fit = {**(saved.fit or {}), "warnings": list(texts), "caveats": []}
        bare = replace(saved, fit=fit, posterior=None, bounds=None, residuals=None, predictive=None)
        return [text for _, text in alerts(bare)]

    same = [f"experiment '{k}' (exp{k}.csv): the clock jumps; it was used as it is" for k in "123"]
    assert told(*same) == [
        "Experiments '1', '2' and '3': the clock jumps; it was used as it is."
    ]  # fmt: skip
    numbers = [("1", "a", 0.2), ("2", "b", 0.31)]
    texts = [f"Experiment '{k}' ({name}.csv): a step of {step} s" for k, name, step in numbers]
    assert told(*texts) == ["Experiments '1' and '2': a step of 0.2 s (numbers of '1')."]
    texts = [f"experiment '{i}': misses by up to {i} V ({90 - i} %)" for i in (1, 3, 2)]
    whole = "Experiments '1', '3' and '2': misses by up to 3 V (87 %) (numbers of '3')."
    assert told(*texts) == [whole]  # those of the worst
    small = "is too small for these data to see"
    subjects = ("the shorter lag", "the longer lag", "V_mL")
    assert told(*(f"{subject} {small}" for subject in subjects), "another") == [
        "Another.",
        "The shorter lag, the longer lag and V are too small for these data to see.",
    ]
    assert told("the same", "the same", "another") == ["The same.", "Another."]
    assert told("experiment 'a: b' (x): odd") == ["Experiment 'a: b': odd."]
