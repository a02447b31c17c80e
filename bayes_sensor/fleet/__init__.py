"""Many campaigns: their list, their results, one table, one figure, one page.

The run itself is :mod:`bayes_sensor.cli.run_fleets`: each campaign is one command ``analyze``.
"""

from bayes_sensor.fleet.comparison import comparison, table, write_comparison
from bayes_sensor.fleet.listing import FleetEntry, read_list
from bayes_sensor.fleet.outcome import COLUMNS, failed_row, row_of

__all__ = [
    "COLUMNS",
    "FleetEntry",
    "comparison",
    "failed_row",
    "read_list",
    "row_of",
    "table",
    "write_comparison",
]
