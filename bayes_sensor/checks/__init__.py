"""Checks of the whole method: predictive, calibration, coverage, and the delays' regressions."""
