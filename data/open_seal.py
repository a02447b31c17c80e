"""Open the seal of data/withheld beside a diagnosis: ``python data/open_seal.py DIR``.

DIR holds the gap.json that ``bayes-sensor gap data/withheld/campaign.toml --out DIR`` wrote.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from bayes_sensor.blind_check.diagnosing import trimmed
from bayes_sensor.blind_check.score import score_case
from bayes_sensor.blind_check.simulator import CAUSES
from bayes_sensor.blind_check.truth import complete_truth
from bayes_sensor.campaign import CampaignError
from bayes_sensor.figures import png
from bayes_sensor.figures.plot_blind_check import opened_seal
from bayes_sensor.io.json_files import read_json, sha256

FOLDER = Path(__file__).parent / "withheld"


def open_seal(folder: Path = FOLDER) -> dict[str, Any]:
    """The truth, after its hash was found to be the one recorded with the campaign."""
    recorded = (folder / "sealed.sha256").read_text().split()[0]
    found = sha256(folder / "sealed.json")
    if found != recorded:
        raise CampaignError(
            f"withheld/sealed.json: expected the hash {recorded[:12]}.., but it is {found[:12]}..; "
            "rebuild data/withheld with make data"
        )
    return complete_truth(read_json(folder / "sealed.json"), "withheld")


def side_by_side(gap: dict[str, Any], truth: dict[str, Any]) -> str:
    """Verdict and truth in two columns, and whether they agree."""
    row = score_case(truth, trimmed(gap))
    verdict, shrink = gap["verdict"], gap["shrink"]
    named = ", ".join(verdict["effects"]) or verdict["kind"]
    cause = CAUSES[truth["causes"][0]]
    acts = sorted(truth["acts"], key=lambda place: -place["share"])
    phases: dict[str, float] = {}
    for place in acts:
        phases[place["phase"]] = phases.get(place["phase"], 0.0) + place["share"]
    where: dict[str, float] = {}
    for cell in gap["where"]:
        where[cell["phase"]] = where.get(cell["phase"], 0.0) + cell["share"]

    def first(shares: dict[str, float]) -> str:
        some = sorted(shares, key=lambda phase: -shares[phase])[:2]
        return ", ".join(f"{phase} {shares[phase]:.0%}" for phase in some if shares[phase] > 0.02)

    def part(value: float | None) -> str:
        return "-" if value is None else f"{value:.0%}"

    lines = [
        ("", "verdict", "truth"),
        ("cause", f"{named} ({verdict['probability']:.0%})", " or ".join(cause.listed_as)),
        ("acts in", first(where), first(phases)),
        ("gap closed", part(shrink["fraction_closed"]), part(row["closed_oracle"])),
        ("tau without it", f"{1e3 * shrink['tau_before_s']:.1f} ms", ""),
        ("tau with it", f"{1e3 * shrink['tau_after_s']:.1f} ms", f"{1e3 * truth['tau_s']:.1f} ms"),
    ]
    widths = [max(len(line[i]) for line in lines) for i in range(3)]
    text = ["   ".join(c.ljust(w) for c, w in zip(line, widths)).rstrip() for line in lines]
    doc = " ".join((cause.turn.__doc__ or "").split())
    agree = "the verdict is right" if row["verdict_right"] else "the verdict is wrong"
    return "\n".join([*text, f"what was done to the rig: {doc}", agree])


def main() -> None:
    """Print, and draw DIR/opened_seal.png; one line and exit 2 where something is missing."""
    if len(sys.argv) != 2:
        print("usage: python data/open_seal.py DIR", file=sys.stderr)
        sys.exit(2)
    folder = Path(sys.argv[1])
    try:
        gap, truth = read_json(folder / "gap.json"), open_seal()
        print(side_by_side(gap, truth))
        figure = opened_seal(gap, score_case(truth, trimmed(gap)))
        (folder / "opened_seal.png").write_bytes(png(figure))
        print(f"figure: {folder / 'opened_seal.png'}")
    except CampaignError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
