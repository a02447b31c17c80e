"""Build data/withheld: a campaign of the independent simulator with one thing wrong, truth sealed.

Which of the causes that the catalogue lists it is, and how strong, follows from the seed, which was
fixed before anything was diagnosed.  Run by ``make data``; the same versions give the same bytes.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_sensor.blind_check.plan import HIDING, Entry, draw_truth
from bayes_sensor.blind_check.simulator import CAUSES, Case, make_campaign
from bayes_sensor.io.disk import write_text
from bayes_sensor.io.json_files import json_text, sha256
from bayes_sensor.io.writers import campaign_text, drive_signal, write_picoscope_mat

SEED = 20260401
LEVEL = 20.0  # detectability: plainly visible, and smaller than the eye would find in the traces

FOLDER = Path(__file__).parent / "withheld"


def draw() -> dict:
    """The truth to be sealed; its ``recipe`` makes the campaign."""
    causes = sorted(
        name
        for name, cause in CAUSES.items()
        if cause.listed and not cause.noise and not cause.fast and name not in HIDING
    )
    chosen = str(np.random.default_rng(SEED).choice(causes))
    return draw_truth(Entry("withheld", "listed", (chosen,), LEVEL, "ar1", "paper", SEED, 1))


def main() -> None:
    """Write the seal first, then the recordings and campaign.toml."""
    FOLDER.mkdir(exist_ok=True)
    truth = draw()
    seal = FOLDER / "sealed.json"
    write_text(seal, json_text(truth))
    write_text(FOLDER / "sealed.sha256", f"{sha256(seal)}  sealed.json\n")
    case = Case.from_json(truth["recipe"])
    campaign = make_campaign(case)
    files = {}
    for e in campaign:
        path = FOLDER / f"run{e.name}.mat"
        channels = {"A": e.values, "B": drive_signal(e, high=3.3)}
        write_picoscope_mat(path, channels, e.interval, lsb=case.lsb)
        files[e.name] = {"file": path.name, "signal": "A", "drive": "B"}
    # the drive channel carries the commanded times
    recorded = tuple(replace(e, commanded_on=None, commanded_off=None) for e in campaign)
    title = "seven step experiments on a simulated rig; what is wrong with it is sealed"
    text = campaign_text(replace(campaign, title=title, experiments=recorded), files)
    (FOLDER / "campaign.toml").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
