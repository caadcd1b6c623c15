"""Terms of a page, each explained in a sentence."""

from __future__ import annotations

from bayes_aero.report.html.page import Facts, Fold

GLOSSARY = {
    "Cramér–Rao bound": "The usual standard error of a maximum-likelihood estimate. It assumes that the errors of "
    "all samples "
    "are independent.",
    "Corrected bound": "The same with the autocorrelation of the residuals (coloured residuals).",
    "White, AR(1) noise": "Noise models: independent samples, and samples that are correlated with their predecessor. "
    "With buffet, the noise grows as the flow separates.",
    "Posterior, 95 % interval": "The probability distribution of a parameter given the data, from prior and "
    "likelihood. The "
    "interval contains the parameter with 95 % probability if the model and the noise model are right.",
    "emcee, NUTS": "Two independent samplers of the same posterior. They should agree.",
    "Lag-1 correlation": "Correlation of a residual with the one a sample earlier: 0 for independent errors, near 1 "
    "for slow ones.",
    "R², r, RMSE, Theil U": "Share of variance explained; correlation; root-mean-square error; Theil's inequality "
    "coefficient, 0 for a perfect fit.",
    "Separation point X": "Where along the chord the flow separates: 1 at the trailing edge (attached), 0 at the "
    "leading edge (stalled).",
    "Hold-out data": "Data that the model was not fitted to: another manoeuvre, or another block of a single one.",
}
FLOWN = {
    "Output error": "Parameters, and initial states unless they are fixed, minimise the difference between measured "
    "outputs and those simulated with the recorded inputs. The simulation is not corrected by measurements.",
    "Cramér–Rao bound": GLOSSARY["Cramér–Rao bound"],
    "Corrected standard error": "The same with the autocorrelation of the residuals and with the prior.",
    "Theil U": "Root-mean-square error over the sum of both signals' root mean squares: 0 for a perfect fit.",
    "Bias, variance, covariance": "Shares of the mean square error: a constant offset, a wrong amplitude, and the "
    "remainder, which includes noise.",
}


def words(terms: dict[str, str]) -> Fold:
    """A glossary behind a line that opens it."""
    return Fold("Terms used here", (Facts(tuple(terms.items())),))


WORDS = words(GLOSSARY)
