"""Build data/reference: a synthetic replica of the paper's seven experiments.

Everything comes from the published tables and the seed below, which was fixed before anything was
fitted.  Run by ``make data``; the same versions of numpy and zlib give the same bytes.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.io.writers import (
    campaign_text,
    drive_signal,
    write_picoscope_csv,
    write_picoscope_mat,
)
from bayes_sensor.likelihood.density import mean_and_variance, simulate
from bayes_sensor.likelihood.problem import Problem

SEED = 20250601
INTERVAL, DURATION = 1e-3, 120.0  # s
TOTAL_RMS, SIGMA0, PHI = 0.0653, 0.045, 0.8  # V, V; published RMS, its quiet part, the coloring
LSB = 2e-4  # V, step of the recorder
PULSE_HIGH = 3.3  # V, published drive level

# Tables I and II and Sec. III-B of the paper
CARRIER = [4.0, 3.0, 2.5, 8.0, 6.0, 5.0, 7.5]  # L/min
TEST_GAS = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.5]  # L/min
Y0 = [0.296, 0.267, 0.263, 0.219, 0.194, 0.175, 0.121]  # V
BETA = [1.78, 1.92, 2.13, 1.41, 1.88, 2.11, 1.85]  # V
T0 = [24.6699, 20.3555, 25.3647, 31.0635, 29.3724, 30.1734, 24.5127]  # s
TF = [83.8527, 79.3072, 84.7885, 89.5093, 88.9165, 89.9908, 84.1776]  # s
SHARED = {"tau_s": 0.0481, "tau_v_s": 0.8577, "V_mL": 58.23}
# delay = intercept + slope/Q and its R2 over six experiments; experiment 4 starts late
START, END = (0.1340, 0.1125, 0.9414), (0.0161, 0.0745, 0.8976)
OUTLIER, OUTLIER_EXTRA = 3, 1.8  # index and s

FOLDER = Path(__file__).parent / "reference"
IN_CSV = "7"


def delays(line: tuple[float, float, float], rng: np.random.Generator) -> np.ndarray:
    """(7,) s: delays whose regression on 1/Q without experiment 4 is exactly the published one."""
    intercept, slope, r2 = line
    x = 60.0 / (np.array(CARRIER) + np.array(TEST_GAS))  # s/L
    six = np.arange(7) != OUTLIER
    design = np.stack([np.ones(6), x[six]], axis=1)
    scatter = rng.standard_normal(6)
    scatter -= design @ np.linalg.lstsq(design, scatter, rcond=None)[0]
    explained = slope**2 * ((x[six] - x[six].mean()) ** 2).sum()
    scatter *= np.sqrt(explained * (1.0 / r2 - 1.0) / (scatter @ scatter))
    values = intercept + slope * x
    values[six] += scatter
    return values


def build() -> tuple[Campaign, dict]:
    """The simulated campaign and its true parameters."""
    rng = np.random.default_rng(SEED)
    on, off = delays(START, rng), delays(END, rng)
    on[OUTLIER] += OUTLIER_EXTRA
    n = round(DURATION / INTERVAL)
    experiments = [
        Experiment(
            name=str(k + 1),
            t=np.arange(n) * INTERVAL,
            y=None,
            carrier_flow=CARRIER[k] * 1000 / 60,
            test_gas_flow=TEST_GAS[k] * 1000 / 60,
            interval=INTERVAL,
            commanded_on=round((T0[k] - on[k]) / INTERVAL) * INTERVAL,
            commanded_off=round((TF[k] - off[k]) / INTERVAL) * INTERVAL,
        )
        for k in range(7)
    ]
    design = Campaign(
        "synthetic replica of the seven published step experiments",
        experiments,
        sensor_is="faster",
    )
    truth = {
        **SHARED,
        "experiments": {
            str(k + 1): {"y0_V": Y0[k], "beta_V": BETA[k], "t0_s": T0[k], "tf_s": TF[k]}
            for k in range(7)
        },
        "phi": PHI,
        "sigma0_V": SIGMA0,
        "sigma1_V": 1.0,
    }
    # sigma1 follows from the published total RMS: mean s^2 = sigma0^2 + sigma1^2 mean(c x3)
    problem = Problem(design)
    vector = problem.layout.flat(truth)
    growth = [mean_and_variance(problem, vector, k)[1].mean() - SIGMA0**2 for k in range(7)]
    truth["sigma1_V"] = float(np.sqrt((TOTAL_RMS**2 - SIGMA0**2) / np.mean(growth)))
    return simulate(design, truth, seed=SEED), truth


def main() -> None:
    """Write the recordings, campaign.toml and truth.json."""
    campaign, truth = build()
    FOLDER.mkdir(exist_ok=True)
    files = {}
    for e in campaign:
        drive = drive_signal(e, high=PULSE_HIGH)
        if e.name == IN_CSV:
            path = FOLDER / f"exp{e.name}.csv"
            values = np.rint(e.values / LSB) * LSB
            write_picoscope_csv(
                path, e.t, {"A": values, "B": drive}, time_unit="s", units=["V", "V"],
                decimals=4, time_decimals=3,
            )  # fmt: skip
        else:
            path = FOLDER / f"exp{e.name}.mat"
            write_picoscope_mat(path, {"A": e.values, "B": drive}, e.interval, lsb=LSB)
        files[e.name] = {"file": path.name, "signal": "A", "drive": "B"}
    # the drive channel carries the commanded times
    recorded = [replace(e, commanded_on=None, commanded_off=None) for e in campaign]
    text = campaign_text(replace(campaign, experiments=tuple(recorded)), files)
    (FOLDER / "campaign.toml").write_text(text, encoding="utf-8")
    (FOLDER / "truth.json").write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
