"""The report's sections, each one question and one file, and their order."""

from __future__ import annotations

from collections.abc import Callable

from bayes_sensor.report.parts import Section
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.blind_check_section import blind_check
from bayes_sensor.report.sections.coating_section import coating
from bayes_sensor.report.sections.computed_section import computed
from bayes_sensor.report.sections.delays_section import switching
from bayes_sensor.report.sections.fit_section import fitted
from bayes_sensor.report.sections.gap_section import gap
from bayes_sensor.report.sections.hardness_section import hardness
from bayes_sensor.report.sections.measured_section import measured
from bayes_sensor.report.sections.next_section import measure_next
from bayes_sensor.report.sections.noise_section import noise
from bayes_sensor.report.sections.restored_section import restored
from bayes_sensor.report.sections.tau_section import time_constant

Maker = Callable[[Saved], Section | None]

SECTIONS: dict[str, Maker] = {
    "measured": measured,
    "fit": fitted,
    "tau": time_constant,
    "noise": noise,
    "hardness": hardness,
    "gap": gap,
    "delays": switching,
    "coating": coating,
    "next": measure_next,
    "restored": restored,
    "blind-check": blind_check,
    "computed": computed,
}
"""what makes each section by its key, in the order of the report"""


def add_section(key: str, make: Maker, after: str = "") -> None:
    """Put a section of your own behind the one with the key ``after``; without one, at the end.

    ``make`` returns None where there are no results for it.  Raises KeyError for an unknown
    ``after``.
    """
    if after and after not in SECTIONS:
        raise KeyError(f"no section '{after}' in the report; there are {', '.join(SECTIONS)}")
    keys = list(SECTIONS)
    SECTIONS[key] = make
    for later in keys[keys.index(after) + 1 :] if after else []:
        SECTIONS[later] = SECTIONS.pop(later)


def make_sections(saved: Saved) -> list[Section]:
    """Every section for which there are results."""
    made = (make(saved) for make in SECTIONS.values())
    return [section for section in made if section is not None]
