"""CSV of results: names are texts in a spreadsheet, too, and come back from other readers."""

import csv
import io

import pandas as pd

from bayes_sensor.io.csv_text import csv_text

NAMES = [
    "=1+2",
    "+cmd|' /C calc'!A0",
    "-2+3",
    "@SUM(A1)",
    "-20",
    "+1e3",
    "a=b",
    '"q", x',
    "気 é",
    "",
]


def test_no_name_begins_a_formula() -> None:
    text = csv_text(pd.DataFrame({"name": NAMES, "value": range(len(NAMES))}))
    found = [row["name"] for row in csv.DictReader(io.StringIO(text))]
    assert [name.removeprefix("'") for name in found] == NAMES
    for name, written in zip(NAMES, found, strict=True):
        assert (written != name) == (name in NAMES[:4])
