"""What a notebook shows: records as HTML with their numbers, names escaped; bars of progress."""

import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import bayes_sensor as bs
from bayes_sensor.bounds import Bounds
from bayes_sensor.display import card, in_kernel, progress_bar, shown
from tests.support.campaigns import small_problem

HOSTILE = '<script>alert("1")</script>'


class Cells(HTMLParser):
    """The texts of a table's cells, row by row; tags must close in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.open: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in {"div", "p", "strong", "table", "thead", "tbody", "tr", "th", "td"}, tag
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "tr" in self.open:
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def campaign() -> bs.Campaign:
    plain = small_problem(phi=0.3)[0].campaign
    named = replace(plain.experiments[0], name=HOSTILE, source="a & b.csv")
    return replace(plain, title=HOSTILE, experiments=(named, *plain.experiments[1:]))


@pytest.fixture(scope="module")
def fit(campaign: bs.Campaign) -> bs.Fit:
    return bs.fit_least_squares(campaign, seed=1, euler=False)


def test_every_result_is_one_line_of_print(campaign: bs.Campaign, fit: bs.Fit) -> None:
    delays, bound = bs.regress_delays(campaign, fit), bs.cramer_rao(campaign, fit)
    profile = bs.compare_bounds(campaign, fit, methods="crlb_iid")["crlb_iid"]
    found = {
        bs.diagnose_residuals(campaign, fit): "Residuals(the noise law fits; phi 0.",
        delays: "Delays(start RegressionLine(",
        delays.start: "RegressionLine(No regression: 2 delays",
        bound: f"CramerRao(sd of tau_s {bound['tau_s']:.4g}, tau_v_s ",
        bs.explain_tau(campaign, fit): "TauExplained(tau 0.",
        profile: f"Bound(crlb_iid: 95 % tau_s {profile.interval('tau_s')[0]:.4g} to ",
    }
    for result, begin in found.items():
        text = repr(result)
        assert text.startswith(begin) and "\n" not in text and "array(" not in text
        assert len(text) < 250


def test_a_campaign_shows_its_experiments(campaign: bs.Campaign) -> None:
    rows = Cells(campaign._repr_html_()).rows
    assert len(rows) == 1 + len(campaign)
    assert rows[1][0] == HOSTILE and rows[1][-1] == "a & b.csv"
    assert rows[1][1] == str(campaign.experiments[0].n_samples)
    assert float(rows[1][4]) == pytest.approx(0.06 * 70.0)
    design = replace(campaign, experiments=tuple(replace(e, y=None) for e in campaign))
    assert Cells(design._repr_html_()).rows[1][-1] == "planned"


def test_a_fit_shows_its_parameters(fit: bs.Fit) -> None:
    rows = Cells(fit._repr_html_()).rows
    assert [row[0] for row in rows[1:]] == fit.names
    values = [float(row[1]) for row in rows[1:]]
    np.testing.assert_allclose(values, fit.theta_hat, rtol=5.1e-4)
    edge = replace(fit, at_bound=["tau_s"], warnings=["tau <= 0?"])._repr_html_()
    assert Cells(edge).rows[1][2] == "at a search bound" and "tau &lt;= 0?" in edge


def test_bounds_show_every_method(campaign: bs.Campaign, fit: bs.Fit) -> None:
    methods = ["crlb_iid", "crlb_ar1", "sandwich"]
    bounds: Bounds = bs.compare_bounds(campaign, fit, methods=methods)
    rows = Cells(bounds._repr_html_()).rows
    assert [row[:2] for row in rows[1:4]] == [["tau_s", method] for method in methods]
    low, high = bounds["sandwich"].interval("V_mL")
    assert [float(text) for text in rows[-1][4:6]] == pytest.approx([low, high], rel=5.1e-4)


def test_a_posterior_shows_intervals_and_whether_to_trust_them(
    campaign: bs.Campaign, fit: bs.Fit
) -> None:
    posterior = bs.sample_posterior(campaign, fit, seed=1, sampler="independence")
    text = posterior._repr_html_()
    rows = Cells(text).rows
    assert text.count(escape(posterior.status)) == 1
    assert len(rows) == 1 + len(posterior.free)
    low, high = posterior.quantiles("tau_v_s", [0.025, 0.975])
    row = next(row for row in rows if row[0] == "tau_v_s")
    assert [float(cell) for cell in row[2:4]] == pytest.approx([low, high], rel=5.1e-4)


def test_nothing_is_markup_that_was_not_meant_to_be() -> None:
    text = card(HOSTILE, [HOSTILE], [HOSTILE], [[HOSTILE]])
    assert "<script" not in text and text.count("&lt;script&gt;") == 4
    assert shown(float("inf")) == "–" and shown(-0.00012345) == "-0.0001234"


def test_there_is_no_bar_outside_a_notebook(capsys: pytest.CaptureFixture[str]) -> None:
    assert not in_kernel()
    tell = progress_bar("fit")
    tell(0.5, "half")
    tell(1.0, "whole")
    assert capsys.readouterr() == ("", "")


SOURCE = f"""
import time
import bayes_sensor.display as notebook
notebook.PATIENCE = notebook.PAUSE = 0.05
quick, slow = notebook.progress_bar("quick"), notebook.progress_bar("slow")
quick(1.0, "over before it shows")
slow(0.1, "too early")
for share in (0.25, 0.5):
    time.sleep(0.1)
    slow(share, "{HOSTILE.replace('"', "'")}")
    slow(share + 0.01, "too soon after")
"""


@pytest.mark.filterwarnings("ignore")  # the Jupyter client's own warnings, not ours
def test_a_bar_moves_in_a_kernel() -> None:
    book = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(SOURCE), nbformat.v4.new_code_cell("slow(1.0, '')")]
    )
    drawn: list[str] = []

    class Watched(NotebookClient):
        def process_message(self, msg: Any, cell: Any, cell_index: int) -> Any:
            if msg["msg_type"] in ("display_data", "update_display_data"):
                drawn.append(msg["content"]["data"]["text/html"])
            return super().process_message(msg, cell, cell_index)

    Watched(book, timeout=60).execute()
    shares = [re.search(r'<progress value="([\d.]+)"', text) for text in drawn]
    assert [match and match[1] for match in shares] == ["0.250", "0.500", None]
    assert all("<script" not in text for text in drawn) and "&lt;script&gt;" in drawn[0]
    assert re.search(r"slow done in \d+ s", drawn[-1])
    assert len([o for cell in book.cells for o in cell.outputs]) == 1  # one bar, redrawn
