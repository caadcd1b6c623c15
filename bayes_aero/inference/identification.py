"""Everything one identification run found, as plain results: what reports are written from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.gp import GPFit
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import Scores
from bayes_aero.inference.stall import Stall
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour
from bayes_aero.model.observations import Forming, Observations


@dataclass(frozen=True)
class Validation:
    """One coefficient on one split's test points: GPR and maximum likelihood trained on the same training points.

    Arrays follow `test` (indices into the observations, ascending). `gp_low`, `gp_high` bound the central 95 %
    predictive interval. `k_hat` is None where the hyperparameters were taken at their maximum a posteriori.
    """

    test: Int[np.ndarray, " m"]
    measured: Float[np.ndarray, " m"]
    gp: Float[np.ndarray, " m"]
    gp_low: Float[np.ndarray, " m"]
    gp_high: Float[np.ndarray, " m"]
    mle: Float[np.ndarray, " m"]
    gp_scores: Scores
    mle_scores: Scores
    coverage: dict[float, float]
    k_hat: float | None
    status: str


@dataclass(frozen=True)
class GPReport:
    """Gaussian processes of one run.

    `splits` maps a split's name (`random`, `block`, `manoeuvre`) to its folds, each a mapping from CL, CD, Cm to the
    validation; only `manoeuvre` has more than one fold. `fits` are the fits of the chosen split's first fold.
    `left_out` says which splits the records do not allow, and why.
    """

    splits: dict[str, list[dict[str, Validation]]]
    fits: dict[str, GPFit]
    chosen: str
    seconds: float
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class Identification:
    """One run on one set of records.

    `alone` holds the maximum-likelihood fit of each manoeuvre by itself. `posteriors` has `emcee` and `nuts` under
    the chosen noise model `noise`, and `white`, by emcee, where that is another one. `stall` is over the draws of the
    first of them. `preparation` tells, in words, what the way the coefficients were formed does to the estimates.
    `forming` is how. `health` is what is wrong with the records' channels, and `consistency` whether the sensors agree.
    `failures` has a sentence on each part that failed unexpectedly. `truth` has the parameters (SI and radians) that
    simulated records were flown with.
    """

    card: Card
    model: Model
    records: tuple[FlightRecord, ...]
    observations: Observations
    noise: Colour
    mle: MleResult
    alone: dict[str, MleResult]
    posteriors: dict[str, Posterior]
    gp: GPReport | None = None
    stall: Stall | None = None
    notes: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()
    health: tuple[HealthFinding, ...] = ()
    preparation: tuple[str, ...] = ()
    consistency: Consistency | None = None
    truth: Mapping[str, float] | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    forming: Forming = Forming.MATCHED
