"""The report's questions, one file each, in the order in which they are answered."""

from __future__ import annotations

from bayes_sensor.report.parts import Pictures, Section
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
from bayes_sensor.report.sections.tau_section import time_constant

SECTIONS = (
    measured,
    fitted,
    time_constant,
    noise,
    hardness,
    gap,
    switching,
    coating,
    measure_next,
    blind_check,
    computed,
)


def make_sections(saved: Saved, pictures: Pictures) -> list[Section]:
    """Every section for which there are results."""
    made = (section(saved, pictures) for section in SECTIONS)
    return [section for section in made if section is not None]
