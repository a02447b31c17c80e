"""What to measure next: predicted intervals of tau, and the experiments that narrow it most."""

from bayes_sensor.design.check_by_simulation import check_design
from bayes_sensor.design.choose_experiments import design_experiments
from bayes_sensor.design.extra_knowledge import what_if
from bayes_sensor.design.proposal import Design

__all__ = ["Design", "check_design", "design_experiments", "what_if"]
