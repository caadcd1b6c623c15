"""Results of one identification run, from which reports are written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency_result import FrequencyFit
from bayes_aero.inference.gp import GPFit
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.pooled_result import NextFlight
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import Scores
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour
from bayes_aero.model.observations import Forming, Observations


@dataclass(frozen=True)
class Validation:
    """One coefficient on one split's test points: GPR and maximum likelihood trained on the same training points."""

    test: Int[np.ndarray, " m"]  # indices into the observations, ascending
    measured: Float[np.ndarray, " m"]
    gp: Float[np.ndarray, " m"]
    gp_low: Float[np.ndarray, " m"]  # of the central 95 % predictive interval
    gp_high: Float[np.ndarray, " m"]
    mle: Float[np.ndarray, " m"]
    gp_scores: Scores
    mle_scores: Scores
    coverage: dict[float, float]
    k_hat: float | None  # None where the hyperparameters were taken at their maximum a posteriori
    status: str


@dataclass(frozen=True)
class GPReport:
    """Gaussian processes of one run."""

    splits: dict[str, list[dict[str, Validation]]]  # folds (several of `manoeuvre` alone), by coefficient
    fits: dict[str, GPFit]  # of the chosen split's first fold
    chosen: str
    seconds: float
    left_out: tuple[str, ...] = ()  # which splits the records do not allow, and why


@dataclass(frozen=True)
class Interval:
    """Median and equal-tailed 95 % interval."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: Float[np.ndarray, " m"]) -> Interval:
        """That of draws."""
        low, median, high = np.quantile(draws, [0.025, 0.5, 0.975])
        return cls(float(median), float(low), float(high))


@dataclass(frozen=True)
class Stall:
    """The steady stall of one model. Angles in rad, rates in rad/s; bands are the 2.5, 50 and 97.5 % quantiles."""

    alpha: Float[np.ndarray, " g"]
    CL: Float[np.ndarray, "3 g"]
    CD: Float[np.ndarray, "3 g"]
    rates: Float[np.ndarray, " r"]
    X: Float[np.ndarray, "r 3 g"]  # over alpha, at each alpha-dot of `rates`
    CL_max: Interval
    alpha_max: Interval
    at_edge: float  # share of draws with their maximum at an end of the recorded angles: a lower limit only
    reference: Mapping[str, float]

    def numbers(self) -> dict[str, Any]:
        """CLmax, its angle (rad) and the share at the edge, for a file."""
        pairs = (("CL_max", self.CL_max), ("alpha_max", self.alpha_max))
        return {name: {"median": i.median, "ci95": [i.low, i.high]} for name, i in pairs} | {"at_edge": self.at_edge}

    @property
    def seen(self) -> bool:
        """Whether the maximum lies inside the recorded angles for nearly every draw."""
        return self.at_edge < 0.025


@dataclass(frozen=True)
class Histogram:
    """Histogram with density 1 for uniform values, and the band that contains all bars of independent values."""

    edges: Float[np.ndarray, " b1"]
    height: Float[np.ndarray, " b"]
    lower: float
    upper: float

    @property
    def outside(self) -> int:
        """Number of bars outside the band."""
        return int(np.sum((self.height < self.lower) | (self.height > self.upper)))


@dataclass(frozen=True)
class PitResult:
    """Probability integral transform of each coefficient by the first posterior; bars; correlation of neighbours."""

    engine: str
    values: Float[np.ndarray, "n c"]
    bars: tuple[Histogram, ...]
    correlation: tuple[float, ...]


@dataclass(frozen=True)
class Identification:
    """One run on one set of records."""

    card: Card
    model: Model
    records: tuple[FlightRecord, ...]
    observations: Observations
    noise: Colour  # the chosen model of the noise
    mle: MleResult
    alone: dict[str, MleResult]  # the fit of each manoeuvre by itself
    posteriors: dict[str, Posterior]  # `emcee` and `nuts` under `noise`; `white`, by emcee, where that is another one
    gp: GPReport | None = None
    next_flight: NextFlight | None = None  # what the manoeuvres say pooled
    stall: Stall | None = None  # over the draws of the first posterior, as `pit`
    pit: PitResult | None = None
    notes: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()  # a sentence on each part that failed unexpectedly
    health: tuple[HealthFinding, ...] = ()  # faults of the records' channels
    preparation: tuple[str, ...] = ()  # sentences on the effect of `forming` on the estimates
    consistency: Consistency | None = None  # whether the sensors agree
    truth: Mapping[str, float] | None = None  # of simulated records, SI and radians
    seconds: dict[str, float] = field(default_factory=dict)
    forming: Forming = Forming.MATCHED
    frequency: FrequencyFit | None = None  # in a band, if one was asked for

    @cached_property
    def fitted(self) -> Float[np.ndarray, "n c"]:
        """CL, CD, Cm of the maximum-likelihood fit at every sample."""
        o = self.observations
        return np.asarray(self.model.predicted(jnp.asarray(self.mle.estimate), o.signals, o.aircraft))
