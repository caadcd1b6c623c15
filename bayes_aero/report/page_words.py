"""Terms that a page uses, each in a sentence."""

from __future__ import annotations

from bayes_aero.report.page import Facts, Fold

GLOSSARY = {
    "Cramér–Rao bound": "The usual standard deviation of a maximum-likelihood estimate. It takes every sample's error "
    "to be independent of its neighbours'.",
    "Corrected bound": "The same, widened for residuals whose neighbouring samples are correlated (coloured).",
    "White, AR(1) noise": "Noise models: independent samples, and samples that follow their predecessor in part. "
    "With buffet, the noise grows as the flow separates.",
    "Posterior, 95 % interval": "What is known of a parameter after the data, from prior and likelihood; the interval "
    "holds it with 95 % probability if model and noise model are right.",
    "emcee, NUTS": "Two independent ways to draw from the same posterior. They should agree.",
    "Lag-1 correlation": "Correlation of a residual with the one a sample earlier: 0 for independent errors, near 1 "
    "for slow ones.",
    "R², r, RMSE, Theil U": "Share of variance explained; correlation; root-mean-square error; Theil's inequality "
    "coefficient, 0 for a perfect fit.",
    "Separation point X": "Where along the chord the flow separates: 1 at the trailing edge (attached), 0 at the "
    "leading edge (stalled).",
    "Unseen data": "Data that the model was not fitted to: another manoeuvre, or another stretch of a single one.",
}
FLOWN = {
    "Output error": "Parameters, and initial states unless they are fixed, are those with which the model, flown "
    "through the recorded inputs, comes nearest to what was measured. Nothing is corrected on the way.",
    "Cramér–Rao bound": GLOSSARY["Cramér–Rao bound"],
    "Corrected deviation": "The same, widened for residuals whose neighbouring samples are correlated (coloured), and "
    "with the prior counted.",
    "Theil U": "Root-mean-square error over the sum of both signals' root mean squares: 0 for a perfect fit.",
    "Bias, variance, covariance": "Shares of the mean square error: a constant offset, a wrong amplitude, and the "
    "rest, which is all that noise leaves.",
}


def words(terms: dict[str, str]) -> Fold:
    """A glossary behind a line that opens it."""
    return Fold("Words used here", (Facts(tuple(terms.items())),))


WORDS = words(GLOSSARY)
