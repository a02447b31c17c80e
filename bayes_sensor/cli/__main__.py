"""Run as ``python -m bayes_sensor.cli``."""

from bayes_sensor.cli import main

main()
