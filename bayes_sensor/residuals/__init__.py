"""What the residuals of a fit look like: correlation in time, variance against gas and slope.

The classical bounds take residuals as white and of one size.  Here both are tested: the sample
autocorrelation beside that of the fitted AR(1), Ljung-Box and Durbin-Watson before and after
whitening, the spread in bins of concentration with a Breusch-Pagan test, and whether AR(1) says
enough about the slow part, which is what widens intervals.

``adequate`` asks of the noise law all that intervals rest on: its correlation, its variance against
concentration and against the slope of the response, and that rounding does not stand for noise.
"""

from bayes_sensor.residuals.autocorrelation import autocorrelation, whiten
from bayes_sensor.residuals.noise_law_check import TAKE_AS_THEY_ARE, TOO_COARSE
from bayes_sensor.residuals.residual_record import Residuals, diagnose_residuals, noise_doubt

__all__ = [
    "TAKE_AS_THEY_ARE", "TOO_COARSE", "Residuals", "autocorrelation", "diagnose_residuals",
    "noise_doubt", "whiten",
]  # fmt: skip
