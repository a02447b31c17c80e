"""The report: saved results in; one HTML page, a PDF or Markdown out.

Everything is read from a results directory, so the report can be rebuilt without the data.  The
first page has the answer; the sections behind it are folded in HTML, and on paper they are printed
if asked for.  Every text from a file or a user is escaped.
"""

from bayes_sensor.report.assemble import PAGES, Report, assemble
from bayes_sensor.report.headline import Headline, chain_words, headline
from bayes_sensor.report.notices import alerts
from bayes_sensor.report.parts import Picture, Section, Table
from bayes_sensor.report.saved import Saved, check_folder, read_results
from bayes_sensor.report.words import list_words, number, p_words, time_words, with_spread
from bayes_sensor.report.write_report import FORMATS, Choice, write_report

__all__ = [
    "FORMATS",
    "PAGES",
    "Choice",
    "Headline",
    "Picture",
    "Report",
    "Saved",
    "Section",
    "Table",
    "alerts",
    "assemble",
    "chain_words",
    "check_folder",
    "headline",
    "list_words",
    "number",
    "p_words",
    "read_results",
    "time_words",
    "with_spread",
    "write_report",
]
