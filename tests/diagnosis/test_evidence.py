"""Refits, evidences and the discrepancy against independent routes."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.special import logsumexp

from bayes_sensor.diagnosis import CATALOGUE
from bayes_sensor.diagnosis.data.noise_floor import DOF
from bayes_sensor.diagnosis.data.preparation import base_coordinates, fit_base, flat_theta, prepare
from bayes_sensor.diagnosis.effects.effect import Form, Strength
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER, Part
from bayes_sensor.diagnosis.evidence.discrepancy import make_discrepancies, matern32
from bayes_sensor.diagnosis.evidence.hypotheses import (
    family_priors,
    most_promising_starts,
)
from bayes_sensor.diagnosis.evidence.laplace_evidence import AT_REST, STRONG, WIDTHS, Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.diagnosis.evidence.varying_parameter import embedded_rivals
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.verdict import judge
from bayes_sensor.rig.imperfections import FIRST, INDEX
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import measured, theta

TABLES = Path(__file__).resolve().parents[2] / "paper" / "tables"


@pytest.fixture(scope="module")
def binned():
    campaign = measured({"valve_asymmetry": 1.15}, seed=3)
    return prepare(campaign, Layout.of(campaign).flat(theta(campaign))).binned


@pytest.fixture(scope="module")
def base(binned):
    return fit_base(binned)


def test_coordinates_and_theta_are_inverse(binned):
    vector = Layout.of(binned.campaign).flat(theta(binned.campaign))
    x = base_coordinates(binned.campaign, vector)
    assert np.allclose(flat_theta(binned.campaign, x), vector[: len(x)])
    # the slower of the two lags that do not depend on the flow is the valve's
    swapped = vector.copy()
    swapped[[0, 1]] = vector[[1, 0]]
    assert np.allclose(base_coordinates(binned.campaign, swapped), x)


@pytest.mark.parametrize("name", ["valve_asymmetry", "baseline_step", "flow_error", "gain_drift"])
def test_means_of_all_experiments_at_once_are_those_of_each(binned, name):
    # each with its own conditions and the first without its fall; and the voltage at the bins'
    # times, averaged here, where no step of the baseline falls into a bin
    effect = CATALOGUE[name]
    rows = [np.full(len(d), True) for d in binned.data]
    rows[0] = ~binned.bins[0].falling
    some = binned.restricted(rows)
    e, cut = some.campaign.experiments[0], int(some.bins[0].last[-1])
    e = replace(e, commanded_off=None, t=e.t[:cut], y=e.y[:cut], mask=None)
    first = replace(some.bins[0], experiment=e)
    some = replace(
        some,
        campaign=replace(some.campaign, experiments=(e, *some.campaign.experiments[1:])),
        bins=(first, *some.bins[1:]),
        base=np.delete(some.base, 6),  # its tf
    )
    for form in effect.forms:
        coords = Coordinates(some, (Part(effect, form),))
        x = coords.start(some.base, form.starts[0])
        together = coords.means(x)
        assert [len(m) for m in together] == [len(d) for d in some.data]
        for k, b in enumerate(some.bins):
            assert np.allclose(together[k], coords.bin_means(x, k), rtol=0.0, atol=1e-12)
            if name != "baseline_step":
                read = b.reduce(coords.mean(x, k))
                assert np.allclose(together[k], read, rtol=0.0, atol=1e-12)


def test_a_noise_free_refit_finds_the_truth(binned):
    effect = CATALOGUE["valve_asymmetry"]
    coords = Coordinates(binned, (Part(effect, effect.forms[0]),))
    truth = coords.start(binned.base, {"closing_ratio": 1.2})
    data = [coords.bin_means(truth, k) for k in range(len(binned.bins))]
    start = coords.start(binned.base, {})
    start[0] += 0.5
    start[1] += 0.05
    found = refit(coords, start, data=data, most_steps=60, tolerance=1e-8)
    assert found.converged
    assert found.misfit < 0.5
    assert found.strength()["closing_ratio"] == pytest.approx(1.2, abs=0.01)


def test_derivatives_do_not_depend_on_the_step(binned, base):
    effect = CATALOGUE["dead_volume"]
    coords = Coordinates(binned, (Part(effect, effect.forms[1]),))
    x = coords.start(base.x, {"pocket_share": 0.05})
    columns = coords.columns(1)
    forward = coords.derivatives(x, coords.all_means(x))[binned.rows[1], : len(columns)]
    for i, c in enumerate(columns):
        up, down = x.copy(), x.copy()
        up[c] += 3 * coords.steps[c]
        down[c] -= 3 * coords.steps[c]
        central = (coords.bin_means(up, 1) - coords.bin_means(down, 1)) / (6 * coords.steps[c])
        central = binned.inverse_factors[1] @ central
        assert np.max(np.abs(forward[:, i] - central)) < 0.03 * np.max(np.abs(central)) + 1e-3


def test_the_sensor_stays_the_faster_lag(binned):
    coords = Coordinates(binned)
    start = binned.base.copy()
    start[0] = -1.0
    found = refit(coords, start, most_steps=3)
    assert found.x[0] >= 0.0
    assert found.tau <= found.tau_v * np.exp(-FASTER) * (1 + 1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_less_gas_than_none_is_not_left_over(binned, sign):
    effect = CATALOGUE["carry_over"]
    coords = Coordinates(binned, (Part(effect, effect.forms[1]),))
    nothing, left = coords.start(binned.base, {}), coords.start(binned.base, {"carry_over": 0.04})
    data = [
        m + sign * (more - m)
        for m, more in zip(coords.means(nothing), coords.means(left), strict=True)
    ]  # fmt: skip
    found = refit(coords, nothing, data=data, most_steps=60, tolerance=1e-6)
    assert found.converged
    carried = found.strength()["carry_over"].values()
    if sign > 0:
        assert np.allclose(list(carried), 0.04, atol=0.002)
    else:
        assert max(carried) == 0.0
        # and nothing is gained by what it may not be
        assert Linearised(found).evidence(None).misfit > found.misfit - AT_REST


def test_gas_left_with_a_spread_is_found(binned):
    effect = CATALOGUE["carry_over"]
    slow, spread = effect.forms[2:4]
    truth = {"carry_over": 0.1, "carry_time": 8.0, "carry_spread": 4.0}
    with_spread = Coordinates(binned, (Part(effect, spread),))
    data = with_spread.means(with_spread.start(binned.base, truth))
    begin = {"carry_over": 0.05, "carry_time": 4.0}
    found = refit(
        with_spread, with_spread.start(binned.base, begin), data=data, most_steps=80, tolerance=1e-6
    )
    single = Coordinates(binned, (Part(effect, slow),))
    other = refit(
        single, single.start(binned.base, begin), data=data, most_steps=80, tolerance=1e-6
    )
    strength = found.strength()
    assert np.allclose(list(strength["carry_over"].values()), 0.1, atol=0.005)
    assert strength["carry_time"] == pytest.approx(8.0, rel=0.1)
    assert strength["carry_spread"] == pytest.approx(4.0, rel=0.1)
    # a single time constant does not do, which is why the form is there
    assert other.misfit > found.misfit + 25.0


def test_gas_left_by_the_record_before_follows_its_concentration(binned):
    form = next(f for f in CATALOGUE["carry_over"].forms if f.name == "of the record before, slow")
    coords = Coordinates(binned, (Part(CATALOGUE["carry_over"], form),))
    truth = coords.start(binned.base, {"carry_over": 0.1, "carry_time": 5.0})
    x = coords.start(binned.base, {"carry_over": 0.05, "carry_time": 4.0})
    data = [coords.bin_means(truth, k) for k in range(len(binned.bins))]
    found = refit(coords, x, data=data, most_steps=60, tolerance=1e-8)
    assert found.converged
    assert found.strength()["carry_over"] == pytest.approx(0.1, abs=0.003)
    # of every record's own step it is as much as the one before had, and nothing of the first's
    concentrations = [e.concentration for e in binned.campaign]
    before = [0.0, *concentrations[:-1]]
    for k, (c, was) in enumerate(zip(concentrations, before, strict=True)):
        p, _ = coords.rig(truth, k)
        assert p[FIRST + INDEX["carry_over"]] == pytest.approx(0.1 * was / c)
    # what came before is known of experiments that stay, too
    keep = [np.full(len(d), k != 1) for k, d in enumerate(binned.data)]
    fewer = binned.restricted(keep).restricted(keep[:1] + keep[2:])
    told = [s.concentration_before for s in fewer.settings]
    assert told == before[:1] + before[2:]


def test_evidence_is_the_multivariate_t_where_the_model_fits():
    """Laplace against the dense t density of the data, the linearised parameters integrated out."""
    campaign = measured({}, seed=5)
    base = fit_base(prepare(campaign, Layout.of(campaign).flat(theta(campaign))).binned)
    line = Linearised(base)
    j = base.jacobian
    prior = base.coords.own_prior_matrix
    # dense route: data ~ t with covariance I + J prior^-1 J'
    covariance = np.eye(len(j)) + j @ np.linalg.solve(prior, j.T)
    centre = base.residual + j @ (base.x - base.coords.prior_centre)
    n = len(j)
    _, log_det = np.linalg.slogdet(covariance)
    square = float(centre @ np.linalg.solve(covariance, centre))
    dense = -0.5 * log_det - 0.5 * (DOF + n) * np.log1p(square / DOF)
    made = line.evidence(None).log_z
    assert made == pytest.approx(dense, abs=1.5)


def test_low_rank_discrepancy_is_the_dense_kernel(binned, base):
    found = {d.name: d for d in make_discrepancies(binned, base)}
    d = found["response 1 0.01"]
    flows = np.log([e.total_flow for e in binned.campaign])
    flow = (flows - flows.mean()) / flows.std()
    n = binned.n_bins
    dense = np.zeros((n, n))
    for falling in (False, True):
        u = [np.log(np.maximum(b.since, 0) / binned.time_scale + 0.06) for b in binned.bins]
        s = [
            np.where(
                (b.falling == falling) & (b.since > 0), abs(base.x[base.coords.local[k] + 1]), 0
            )
            for k, b in enumerate(binned.bins)
        ]
        for k, rows in enumerate(binned.rows):
            for m, columns in enumerate(binned.rows):
                common = 1 + 0.25 * flow[k] * flow[m] + (0.01 if k == m else 0.0)
                kernel = matern32(np.subtract.outer(u[k], u[m]), 1.0) * common
                dense[rows, columns] += 1e-4 * kernel * np.outer(s[k], s[m])
    for k, rows in enumerate(binned.rows):
        dense[rows] = binned.inverse_factors[k] @ dense[rows]
    for k, rows in enumerate(binned.rows):
        dense[:, rows] = dense[:, rows] @ binned.inverse_factors[k].T
    made = d.basis @ (d.variance[:, None] * d.basis.T)
    # the kernel is interpolated from a grid: up to a tenth of its variance is lost between
    assert np.max(np.abs(made - dense)) < 0.1 * np.max(np.abs(dense))
    _, exact = np.linalg.slogdet(np.eye(n) + made)
    assert d.log_determinant() == pytest.approx(exact, rel=1e-6)
    v = np.random.default_rng(1).standard_normal((n, 3))
    assert np.allclose(v.T @ v - d.absorbed(v), v.T @ np.linalg.solve(np.eye(n) + made, v))


def not_taken_up(d, v):
    """(I + K)^-1 v: what the process leaves to the noise."""
    return np.linalg.solve(np.eye(len(v)) + d.basis @ (d.variance[:, None] * d.basis.T), v)


def test_timing_is_the_mean_at_another_time(binned, base):
    # a rise that runs late by w(t), smooth in the logarithm of the time since the switch
    scale = binned.time_scale

    def late(b):
        since = np.maximum(b.since, 0.0)
        return (
            0.01 * scale * np.where(b.falling, 0.0, np.exp(-0.5 * np.log(since / scale + 0.1) ** 2))
        )

    moved = []
    for k, b in enumerate(binned.bins):
        ends = np.append(b.starts[1:], len(b.times))
        w = np.repeat(late(b), ends - b.starts)
        order = np.argsort(b.times - w)
        mean = np.empty(len(b.times))
        mean[order] = base.coords.mean(base.x, k, (b.times - w)[order])
        here = b.reduce(mean) - b.reduce(base.coords.mean(base.x, k, b.times))
        moved.append(binned.inverse_factors[k] @ here)
    wanted = np.concatenate(moved)
    d = {d.name: d for d in make_discrepancies(binned, base)}["timing 1 0.01"]
    left = not_taken_up(d, wanted)
    assert np.linalg.norm(left) < 0.15 * np.linalg.norm(wanted)
    # and it takes nothing up where nothing moves
    still = np.concatenate([(b.since > 20.0 * scale) & ~b.falling for b in binned.bins])
    assert still.sum() > 10
    assert np.linalg.norm(not_taken_up(d, 1.0 * still)) > 0.98 * np.sqrt(still.sum())


def test_a_readout_is_off_by_a_function_of_what_it_reads(binned, base):
    # a sawtooth over the voltage, as of a converter whose stages do not match
    def sawtooth(volts):
        return 0.02 * binned.signal_scale * ((volts / (0.25 * binned.signal_scale)) % 1.0 - 0.5)

    def drift(at):
        return 0.02 * binned.signal_scale * ((at / 7.0) % 1.0 - 0.5)

    errors, others = [], []
    for k, b in enumerate(binned.bins):
        mean = b.reduce(base.coords.mean(base.x, k, b.times))
        errors.append(binned.inverse_factors[k] @ sawtooth(mean))
        others.append(binned.inverse_factors[k] @ drift(b.centre))
    wanted, other = np.concatenate(errors), np.concatenate(others)
    d = {d.name: d for d in make_discrepancies(binned, base)}["readout 0.05 0.015"]
    assert np.linalg.norm(not_taken_up(d, wanted)) < 0.2 * np.linalg.norm(wanted)
    assert np.linalg.norm(not_taken_up(d, other)) > 0.5 * np.linalg.norm(other)


def test_a_gain_that_wanders_takes_another_course_in_every_experiment(binned, base):
    # a sun behind clouds, another laser power every time: nothing without gas
    def course(k, b):
        return 0.02 * np.sin(2.0 * np.pi * (b.centre / (11.0 + 3.0 * k) + 0.3 * k))

    gains, drifts = [], []
    for k, b in enumerate(binned.bins):
        above = b.reduce(base.coords.mean(base.x, k, b.times)) - base.x[base.coords.local[k]]
        gains.append(binned.inverse_factors[k] @ (course(k, b) * above))
        drifts.append(binned.inverse_factors[k] @ (course(k, b) * binned.signal_scale))
    wanted, other = np.concatenate(gains), np.concatenate(drifts)
    found = {d.name: d for d in make_discrepancies(binned, base)}
    slow = found["gain 8 s 0.015"]
    assert np.linalg.norm(not_taken_up(slow, wanted)) < 0.1 * np.linalg.norm(wanted)
    assert np.linalg.norm(not_taken_up(slow, other)) > 0.5 * np.linalg.norm(other)
    fitted = Linearised(replace(base, residual=base.residual + wanted))
    logs = {d.name: fitted.evidence(d).log_z for d in found.values()}
    assert max(logs, key=logs.__getitem__).startswith("gain")


def test_own_strengths_that_are_alike_have_a_correlated_prior(binned):
    effect = CATALOGUE["baseline_step"]
    form = next(f for f in effect.forms if f.name == "own")
    coords = Coordinates(binned, (Part(effect, form),))
    widths = np.full(coords.size, 1.0)
    at = [end - 1 for end in coords.local[1:]]
    widths[at] = 3.0
    alike = coords.own[0].alike
    n = len(at)
    covariance = 9.0 * ((1.0 - alike) * np.eye(n) + alike)
    matrix = coords.prior_matrix(widths)
    assert alike > 0.5
    assert np.allclose(np.linalg.inv(matrix[np.ix_(at, at)]), covariance)
    assert not matrix[np.ix_(at, np.setdiff1d(np.arange(coords.size), at))].any()
    sign, exact = np.linalg.slogdet(matrix)
    assert sign > 0
    assert coords.log_prior_determinant(widths) == pytest.approx(exact, rel=1e-9)


def test_what_repeats_itself_is_common_or_follows_flow_or_concentration(binned, base):
    # a misfit of one form: alike in all, or going with the flow, or with the concentration
    def bump(b):
        return np.exp(-0.5 * (np.log(np.maximum(b.since, 1e-3) / binned.time_scale) - 0.3) ** 2)

    def best(size):
        wanted = np.concatenate([
            binned.inverse_factors[k] @ (0.02 * size[k] * binned.signal_scale * bump(b))
            for k, b in enumerate(binned.bins)
        ])  # fmt: skip
        fitted = replace(base, residual=base.residual + wanted)
        found = {d.name: Linearised(fitted).evidence(d).log_z for d in discrepancies}
        return max((n for n in found if n.startswith("response")), key=found.__getitem__)

    discrepancies = make_discrepancies(binned, base)
    logs = np.log([e.total_flow for e in binned.campaign])
    flow = (logs - logs.mean()) / logs.std()
    assert sum(d.weight for d in discrepancies) == pytest.approx(
        3 * 0.03 + 0.45 + 0.2 + 0.15 + 0.2 + 4 * 0.05
        + (0.15 if any(d.name.startswith("switching") for d in discrepancies) else 0.0)
    )  # fmt: skip
    # of another size in every experiment, with neither flow nor concentration: as much an own part
    assert " each " in best(np.array([1.0, -2.0, 3.0, -0.5, 2.5, -3.0, 1.0])[: len(flow)])
    assert " alike " in best(np.ones(len(flow)))
    assert " alike " not in best(1.0 + 0.9 * flow)

    def dosed(tenths):
        experiments = tuple(
            replace(
                e, test_gas_flow=0.1 * q * e.total_flow, carrier_flow=(1 - 0.1 * q) * e.total_flow
            )
            for e, q in zip(binned.campaign, tenths, strict=True)
        )
        return replace(binned, campaign=replace(binned.campaign, experiments=experiments))

    tenths = np.array([1.0, 3.0, 2.0, 3.0, 1.0, 3.0, 2.0])[: len(flow)]
    discrepancies = make_discrepancies(dosed(tenths), base)
    trend = np.log(tenths) - np.log(tenths).mean()
    assert "by concentration" in best(1.0 + 0.9 * trend / trend.std())
    for told_nothing in (np.full(len(flow), 2.0), 4.0 * np.exp(-logs) / np.exp(-logs).max()):
        discrepancies = make_discrepancies(dosed(told_nothing), base)
        assert not any("by concentration" in d.name for d in discrepancies)


def test_what_something_else_does_to_rise_and_fall(binned, base):
    # a misfit of the response, in time or in gas that has passed, of both switches or of one
    discrepancies = make_discrepancies(binned, base)
    scale = binned.time_scale
    flow = [e.total_flow / binned.reference_flow for e in binned.campaign]

    def best(rise, fall, by_volume=False):
        wanted = []
        for k, b in enumerate(binned.bins):
            since = np.maximum(b.since, 1e-3) * (flow[k] if by_volume else 1.0) / scale
            bump = np.exp(-0.5 * ((np.log(since) - 0.3) / 0.5) ** 2) * (b.since > 0.0)
            beta = base.x[base.coords.local[k] + 1]
            size = beta * np.where(b.falling, fall, rise)
            wanted.append(binned.inverse_factors[k] @ (0.01 * size * bump))
        line = Linearised(replace(base, residual=np.concatenate(wanted)))
        found = {d.name: line.evidence(d).log_z for d in discrepancies}
        return max(found, key=found.__getitem__)

    assert " mirrored " in best(1.0, -1.0)
    assert " mirrored" not in best(1.0, 1.0)
    assert " rise " in best(1.0, 0.0)
    assert " fall " in best(0.0, 1.0)
    assert "by volume mirrored" in best(2.0, -2.0, by_volume=True)


NAMED = re.compile(
    r"(?P<part>[a-z]+( [\d.]+( s)?)??)( (?P<course>mirrored|rise|fall|by volume( mirrored)?))?"
    r"( (?P<shared>alike|each|by concentration))?( [\d.]+)?(?P<drift> and drift [\d.]+)?"
)
"""a configuration's part, course, what experiments share of it, and size"""


@pytest.mark.tables
def test_weights_alone_are_those_of_the_study(binned, base):
    table = pd.read_csv(TABLES / "unlisted_weights.csv").set_index(["of", "name"])
    assert (abs(table["learned"] - table["taken"]) < 0.08).all()
    found = {row: 0.0 for row in table.index}
    for d in make_discrepancies(binned, base):
        words = NAMED.fullmatch(d.name)
        assert words is not None
        part = "response and drift" if words["drift"] else words["part"]
        found["part", part] += d.alone
        if part.startswith(("response", "timing")) and not words["drift"]:
            found["course", words["course"] or "apart"] += d.alone
        if not part.startswith(("drift", "gain", "herald")) and not words["drift"]:
            found["shared", words["shared"] or "by flow"] += d.alone
    for of in ("part", "course", "shared"):
        taken = table.loc[of]["taken"]
        weights = pd.Series({name: found[of, name] for name in taken.index})
        assert list(weights / weights.sum()) == pytest.approx(list(taken), abs=6e-4)
        assert of != "part" or weights.sum() == pytest.approx(1.0)


def test_leverage_is_the_projection_of_noise(binned, base):
    leverage = base.leverage
    noise = np.random.default_rng(1).standard_normal((binned.n_bins, 400))
    left = leverage.leave(noise)
    assert np.mean(np.sum(left**2, axis=0)) == pytest.approx(leverage.trace(), rel=0.02)
    rows = np.arange(5, 40)
    sample = left[rows] @ left[rows].T / noise.shape[1]
    assert np.max(np.abs(np.diag(sample) - np.diag(leverage.block(rows)))) < 0.35


@pytest.mark.parametrize(
    ("rows", "kind", "said"),
    [
        # the noise alone is named where the mean may well be in order
        ({"heavy_tails": 0.6, "flow_settling+heavy_tails": 0.2, "unlisted": 0.2}, "effect",
         ("heavy_tails",)),
        ({"heavy_tails": 0.92, "flow_settling+heavy_tails": 0.04, "unlisted": 0.04}, "effect",
         ("heavy_tails",)),
        # .. not where it is not, although no family reaches what it takes to be named beside it
        ({"flow_settling+heavy_tails": 0.45, "valve_asymmetry+heavy_tails": 0.2, "unlisted": 0.35},
         "family", None),
        ({"flow_settling+heavy_tails": 0.95, "unlisted": 0.05}, "effect",
         ("flow_settling", "heavy_tails")),
    ],
)  # fmt: skip
def test_an_effect_of_the_noise_does_not_hide_the_mean(rows, kind, said):
    combined = Probabilities({"none": 0.0, **rows}, CATALOGUE)
    found, members, family, p = judge(combined, 0.0)
    assert found == kind
    assert p == rows["+".join(members)] if kind == "effect" else p == combined.families[family]
    assert members == said if said else family == "asymmetry"


def test_priors_go_over_families_first():
    priors = family_priors(CATALOGUE)
    families = {}
    for name, p in priors.items():
        families.setdefault(CATALOGUE[name].family, []).append(np.exp(p))
    totals = [sum(v) for v in families.values()]
    assert np.allclose(totals, totals[0])
    assert sum(totals) == pytest.approx(0.35)


def test_a_joined_start_keeps_what_was_fitted(binned, base):
    first, second = CATALOGUE["flow_error"], CATALOGUE["baseline_drift"]
    one = Coordinates(binned, (Part(first, first.forms[0]),))
    fitted = refit(one, one.start(base.x, {}), most_steps=5)
    two = Coordinates(binned, (*one.parts, Part(second, second.forms[1])))
    x = two.with_strengths(two.start_from(fitted.coords, fitted.x), {})
    for k in range(len(binned.bins)):
        assert np.allclose(two.bin_means(x, k), one.bin_means(fitted.x, k), atol=1e-9)


def test_a_dependence_that_has_a_name_is_no_rival():
    def names(catalogue, flows=True, fall=True, commanded=True):
        return {
            r.name for r in embedded_rivals(map(CATALOGUE.get, catalogue), flows, fall, commanded)
        }

    assert "valve by direction" not in names(CATALOGUE)
    fewer = [n for n in CATALOGUE if n != "valve_asymmetry"]
    assert "valve by direction" in names(fewer)
    assert not any("flow" in n for n in names(CATALOGUE, flows=False))
    assert not any("direction" in n for n in names([], fall=False))
    assert "pulse at commands" in names(CATALOGUE)
    assert "pulse at commands" not in names(CATALOGUE, commanded=False)


@pytest.mark.parametrize(
    "settings",
    [
        {"step": 0.02, "step_time": 20.3},
        {"step": 0.02, "step_time": 1.7, "step_with_fall": 1.0},
        {"step": -0.01, "step_time": 0.4, "step_with_fall": 1.0, "step_width": 0.9},
    ],
)
def test_a_step_inside_a_bin_has_the_mean_over_its_samples(binned, settings):
    # the nodes of a bin do not tell where in it a step is; the sum over samples does
    effect = CATALOGUE["baseline_step"]
    form = Form(lambda _: (Strength("step", "V", "normal", 0.0, 0.01),), lambda _v, _s: settings)
    coords = Coordinates(binned, (Part(effect, form),))
    x = coords.start(binned.base, {})
    for k, (b, e) in enumerate(zip(binned.bins, binned.campaign, strict=True)):
        without = Coordinates(binned).bin_means(np.delete(x, 3), k)
        added = coords.bin_means(x, k) - without
        # the samples' own steps, a hundred to a sample
        fine = (e.t[:, None] + (np.arange(100) / 100.0 - 0.495) * e.interval).ravel()
        begin = settings["step_time"]
        begin += x[coords.local[k] + 3] if "step_with_fall" in settings else 0.0
        settled = (fine >= begin).astype(float)
        if "step_width" in settings:
            settled *= 1.0 - np.exp(-np.maximum(fine - begin, 0.0) / settings["step_width"])
        expected = settings["step"] * b.average(settled.reshape(-1, 100).mean(axis=1))
        assert np.allclose(added, expected, atol=3e-6)
    assert np.all(np.isfinite(coords.derivatives(x, coords.all_means(x))))


def test_the_starts_of_a_grid_are_those_that_gain(base, binned):
    effect = CATALOGUE["baseline_step"]
    form = next(f for f in effect.forms if f.name == "at any time")
    coords = Coordinates(binned, (Part(effect, form),))
    begun = coords.start_from(base.coords, base.x)
    times = [0.3 * 60.0, 0.7 * 60.0]
    stepped = []
    for k, b in enumerate(binned.bins):
        steps = sum(size * b.average((b.experiment.t > at) * 1.0)
                    for size, at in zip((0.01, -0.02), times, strict=True))  # fmt: skip
        stepped.append(binned.inverse_factors[k] @ steps)
    r = np.concatenate(stepped)
    normal = base.jacobian.T @ base.jacobian + base.coords.own_prior_matrix
    left = r - base.jacobian @ np.linalg.solve(normal, base.jacobian.T @ r)
    spoilt = replace(base, residual=left)
    first, second = most_promising_starts(coords, begun, spoilt, form.grid)[:2]
    assert first["step_place"] == pytest.approx(0.7, abs=0.021)
    assert first["step*"] * binned.height < -0.01
    assert second["step_place"] == pytest.approx(0.3, abs=0.041)


def test_what_a_refit_was_promised_and_did_not_get_is_not_credited(base):
    at_rest = Linearised(base)
    assert at_rest.promised is None
    # stopped 8 steps of its own deviation from the optimum, as a bend would stop it
    x = base.x.copy()
    x[2] += 8.0 / np.sqrt(float(np.sum(base.jacobian[:, 2] ** 2)))
    coords, binned = base.coords, base.coords.binned
    residual = np.concatenate(
        [
            binned.inverse_factors[k] @ (y - coords.bin_means(x, k))
            for k, y in enumerate(binned.data)
        ]
    )
    away = x - coords.prior_centre
    objective = float(residual @ residual + away @ coords.own_prior_matrix @ away)
    stuck = Linearised(Refit(coords, x, residual, objective, True))
    assert stuck.promised is not None
    assert stuck.promised[2] == pytest.approx(base.x[2] - x[2], rel=0.2)
    found = stuck.evidence(None)
    assert found.misfit == pytest.approx(stuck.refit.misfit, rel=1e-3)
    assert found.log_z < at_rest.evidence(None).log_z - 3.0


def test_a_refit_stuck_at_wrong_differences_goes_on_with_finer_ones(binned):
    # a strength that acts beyond a kink far closer than the usual difference
    form = Form(
        lambda _: (Strength("step", "V", "normal", 0.0, 1.0),),
        lambda v, _s: {"step": 0.02 * np.tanh(300.0 * v["step"]), "step_time": 25.0},
    )
    coords = Coordinates(binned, (Part(CATALOGUE["baseline_step"], form),))
    truth = coords.start(binned.base, {"step": 3e-3})
    data = [coords.bin_means(truth, k) for k in range(len(binned.bins))]
    start = coords.start(binned.base, {"step": 1e-4})
    found = refit(coords, start, data=data, most_steps=60, tolerance=1e-6)
    assert found.strength()["step"] == pytest.approx(3e-3, rel=0.02)


def strong(binned):
    """Noise-free data of drifts far beyond the plausible, and their plan, truth and coordinates."""
    effect = CATALOGUE["baseline_drift"]
    coords = Coordinates(binned, (Part(effect, effect.forms[1]),))
    own = [end - 1 for end in coords.local[1:]]
    truth = coords.start(binned.base, {})
    truth[own] = [30.0, -20.0, 25.0, -30.0]  # spreads of the prior
    data = tuple(coords.bin_means(truth, k) for k in range(len(binned.bins)))
    return replace(coords, binned=replace(binned, data=data)), truth, own


def test_an_amplitude_far_beyond_the_plausible_is_not_held_back(binned):
    coords, truth, own = strong(binned)
    held = refit(coords, truth, tolerance=1e-6)
    free = held.loosened
    sd = np.sqrt(np.diag(np.linalg.inv(held.normal))[own])
    assert np.max(np.abs(held.x - truth)[own] / sd) > 1.0
    assert np.max(np.abs(free.x - truth)[own] / sd) < 0.05
    assert free.misfit < 0.05 * held.misfit
    assert free.coords.loose == {"drift"} and free.loosened is free
    # what is plausible stays as it is, and so does a fit without effects
    modest = truth.copy()
    modest[own] = [1.0, -0.5, 0.8, -1.0]
    weak = refit(
        coords, modest, data=[coords.bin_means(modest, k) for k in range(len(binned.bins))]
    )
    assert weak.loosened is weak
    assert fit_base(binned).loosened.coords.loose == frozenset()


def test_evidence_of_a_strong_amplitude_is_averaged_over_wider_priors_too(binned):
    coords, truth, own = strong(binned)
    held = refit(coords, truth, tolerance=1e-6)
    free = held.loosened
    assert [w[own[0]] for w in Linearised(held).widths] == list(WIDTHS)
    widths = Linearised(free).widths
    assert all(list(w[own]) == 4 * [v] for w, v in zip(widths, (*WIDTHS, *STRONG), strict=True))
    assert all(np.all(np.delete(w, own) == 1.0) for w in widths)

    def alone(width):
        made = Linearised(free)
        made.__dict__["widths"] = [width]
        return made.evidence(None).log_z

    each = [alone(w) for w in widths]
    found = Linearised(free).evidence(None)
    assert found.log_z == pytest.approx(logsumexp(each) - np.log(len(each)))
    # what is thirty times as large as is plausible is likeliest where that is no surprise
    assert np.all(np.diff(each[1:]) > 0.0)
    # and there tau is the truth's, which the prior had bent away
    log_tau = truth[1] - FASTER - truth[0]
    assert abs(found.log_tau - log_tau) < 0.2 * abs(np.log(held.tau) - log_tau)
