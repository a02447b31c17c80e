"""Checks of the whole method: predictive checks, coverage of intervals, regressions of delays."""
