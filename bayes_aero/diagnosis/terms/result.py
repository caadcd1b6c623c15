"""What is reported of a form found for structure that no effect of the catalogue explains."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_aero.diagnosis.terms.library import Term


@dataclass(frozen=True)
class FoundTerm:
    """A term of a coefficient, with its factor; SI, the standard error counts the autocorrelation of the residuals.

    Attributes:
        coefficient: to which it adds size times the term.
        term: the product.
        size: estimate and standard error of its factor.
        share: of the coefficient's variance that was left without it; by trajectories and innovations, of the output
            of which it takes the largest share.
        gain: log density of left-out folds, divided by the variance inflation, that it gains.
        weight: posterior probability of this term among itself and the `others`.
        others: terms of about the same gain that these records do not tell from it, with the weight of each.
        least: smallest factor worth modelling, by what it changes the coefficient over the swing of these flights.
    """

    coefficient: str
    term: Term
    size: tuple[float, float]
    share: float
    gain: float
    weight: float
    others: tuple[tuple[Term, float], ...]
    least: float
