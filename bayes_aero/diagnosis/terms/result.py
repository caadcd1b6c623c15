"""What is reported of a form found for structure that no effect of the catalogue explains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bayes_aero.diagnosis.terms.library import Term

LIKELY = 0.5  # probability beyond which a term is there rather than not


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


@dataclass(frozen=True)
class SampledSet:
    """Terms that follow one another in these flights, as a sample of sets of terms has them.

    Attributes:
        terms: with the inclusion probability of each, the most probable first.
        probability: that at least one of them is there.
        known: whether one of them is a term of the forward selection, or as good as one.
    """

    terms: tuple[tuple[Term, float], ...]
    probability: float
    known: bool


@dataclass(frozen=True)
class SampledTerms:
    """A posterior over sets of terms of one coefficient, sampled beside the forward selection: a witness, no finding.

    Attributes:
        coefficient: whose residual is described.
        sets: collinear terms, the most probable set first.
        found: by each term of the forward selection, probability of it and of it or any term as good as it.
        count: mean number of terms.
        status: of the chains, in words.
        rhat: largest of the chains.
        ess: least effective sample size.
        divergent: share of divergent steps of NUTS.
        reliable: whether the chains may be used.
    """

    coefficient: str
    sets: tuple[SampledSet, ...]
    found: Mapping[str, tuple[float, float]]
    count: float
    status: str
    rhat: float
    ess: float
    divergent: float
    reliable: bool

    @property
    def missing(self) -> tuple[str, ...]:
        """Terms of the forward selection that are absent more probably than not, those as good as they with them."""
        return tuple(name for name, (_, among) in self.found.items() if among < LIKELY)

    @property
    def more(self) -> tuple[SampledSet, ...]:
        """Sets that are there more probably than not and hold no term of the forward selection or as good as one."""
        return tuple(one for one in self.sets if one.probability >= LIKELY and not one.known)

    @property
    def agrees(self) -> bool:
        """Whether it has the terms of the forward selection and no others."""
        return not (self.missing or self.more)
