"""The blind check: how often is the diagnosis right on data whose cause it does not know?

Cases come from an independent simulator.  Truths are sealed before the diagnosis runs and opened
after its verdicts are recorded.
"""

from bayes_sensor.blind_check.card import card_table, make_card, score, table
from bayes_sensor.blind_check.diagnosing import SETTINGS, diagnose, diagnose_cases
from bayes_sensor.blind_check.plan import LEVELS, Entry, draw_truth, make_plan
from bayes_sensor.blind_check.sealing import draw_cases, open_seals, sealed_late
from bayes_sensor.blind_check.statistics import wilson

__all__ = [
    "LEVELS", "SETTINGS", "Entry", "card_table", "diagnose", "diagnose_cases", "draw_cases",
    "draw_truth", "make_card", "make_plan", "open_seals", "score", "sealed_late",
    "table", "wilson",
]  # fmt: skip
