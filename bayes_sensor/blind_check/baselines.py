"""What one would do without the diagnosis: rank by RSS or BIC, test the residuals for whiteness."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign
from bayes_sensor.rig.cascade import predict
from bayes_sensor.rig.layout import Layout, Theta

LAGS = 40
WHITENESS_ALARM = 0.01
"""p-value under which the whiteness test alarms"""
BIC_MARGIN = 10.0
"""how far an effect's BIC must lie below the plain cascade's to be named (Kass and Raftery 1995)"""


def whiteness_p_value(campaign: Campaign, theta: Theta) -> float:
    """p-value of Ljung and Box's test on AR(1) innovations of the residuals, all experiments.

    Q = n (n + 2) sum_k r_k^2/(n - k) over 40 lags, summed over experiments; each spends one degree
    of freedom on its coefficient (Biometrika 65, 297, 1978).
    """
    from scipy import stats

    means = predict(campaign, Layout.of(campaign).flat(theta))
    total, dof = 0.0, 0
    for e in campaign:
        longest = max(e.runs, key=lambda run: run[1] - run[0])
        r = (e.values - means[e.name])[longest[0] : longest[1]]
        r = r - r.mean()
        lags = min(LAGS, len(r) // 4)
        if lags < 2:
            continue
        phi = float(r[1:] @ r[:-1] / (r[:-1] @ r[:-1]))
        innovations = r[1:] - phi * r[:-1]
        n = len(innovations)
        power = innovations @ innovations
        acf = np.array([innovations[k:] @ innovations[:-k] for k in range(1, lags + 1)]) / power
        total += float(n * (n + 2) * np.sum(acf**2 / (n - np.arange(1, lags + 1))))
        dof += lags - 1
    return float(stats.chi2.sf(total, dof)) if dof else 1.0


def by_rss(rows: Iterable[Mapping[str, Any]]) -> str:
    """The single effect with the least sum of squares; it always names one (``none``: no row)."""
    found = {row["effect"]: _number(row, "rss") for row in _singles(rows)}
    known = {name: value for name, value in found.items() if value is not None and name != "none"}
    return min(known, key=known.__getitem__) if known else "none"


def by_bic(rows: Iterable[Mapping[str, Any]]) -> str:
    """The single effect with the least BIC, or ``none`` unless it is 10 below the cascade's."""
    found = {row["effect"]: _number(row, "bic") for row in _singles(rows)}
    known = {name: value for name, value in found.items() if value is not None}
    if not known:
        return "none"
    best = min(known, key=known.__getitem__)
    return best if known[best] < known.get("none", np.inf) - BIC_MARGIN else "none"


def _singles(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [row for row in rows if "+" not in row["effect"] and row["effect"] != "unlisted"]


def _number(row: Mapping[str, Any], key: str) -> float | None:
    for name, value in row.items():
        if name.split("_")[0] == key and value is not None:
            return float(value)
    return None
