"""The result of an output-error fit: estimates, standard errors for white and coloured residuals, a status."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.covariance import BLOCK, LinearFit, calibration, corrected_covariance, means
from bayes_aero.inference.likelihood.mle_result import Inseparable, inseparable
from bayes_aero.inference.likelihood.normal_equations import NormalPriors, Point, reduced_equations
from bayes_aero.parameter import Parameter

THINNING = 5  # samples averaged for the autocorrelation of the residuals
INDEFINITE = -1e-14  # eigenvalues of a scaled information matrix below this are not rounding errors
SINGULAR = 1e-13  # least eigenvalue of a regular scaled information matrix
MIN_COMPONENT = 1e-3  # least component of a singular direction from which a parameter is undetermined
PRIOR_RATIO = 0.9  # posterior over prior standard deviation from which a parameter is held by its prior


class OutputErrorStatus(Enum):
    """How the fit ended; the value is the text for the user."""

    CONVERGED = "converged"
    AT_BOUND = "converged with a parameter at its bound: its standard error is not reliable; widen the bound or fix it"
    NOT_CONVERGED = "stopped before the optimum: start nearer, or begin with shorter windows; do not use the numbers"
    LEFT_ENVELOPE = (
        "the simulation leaves the flight envelope at every parameter value tried: the model cannot be simulated "
        "through this record; "
        "check signs and units, or begin with shorter windows"
    )


@dataclass(frozen=True)
class OutputErrorResult:
    """An output-error fit: estimates of k parameters and of the initial state of each segment, in SI and radians.

    `covariance` (k, k) is that of Cramer and Rao with priors, `information` (k, k) that of the data alone. `rms` is by
    segment and output, in the recorded unit. `columns` are residual and sensitivities (parameters, then initial state),
    both divided by the noise growth `flown.noise_growth`; `R` is the residual variance in attached flow.
    """

    flown: SegmentTrajectories
    parameters: tuple[Parameter, ...]
    estimate: Float[np.ndarray, " k"]
    departure: Float[np.ndarray, "w s"]
    R: Float[np.ndarray, " c"]
    cost: float
    covariance: Float[np.ndarray, "k k"]
    information: Float[np.ndarray, "k k"]
    priors: NormalPriors
    rms: Float[np.ndarray, "w c"]
    status: OutputErrorStatus
    iterations: int
    at_bound: tuple[str, ...]
    columns: Float[np.ndarray, "w n c j"]
    eliminated: Float[np.ndarray, "w s k"]  # minus the derivative of the optimal initial states by theta
    undetermined: tuple[str, ...] = ()  # parameters without prior that the record does not determine

    @property
    def det_R(self) -> float:
        """Determinant of the diagonal residual covariance of the outputs, SI: the cost of published programs."""
        count = self.flown.inside.sum(axis=1)
        return float(np.prod(np.sum(count[:, None] * self.rms**2, axis=0) / count.sum()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Standard errors with priors, for white residuals, (k,); infinite where undetermined."""
        return self._finite_if_determined(np.sqrt(np.diag(self.covariance)))

    def _finite_if_determined(self, sd: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Standard errors with infinity for undetermined parameters."""
        return np.where([name in self.undetermined for name in self.names], np.inf, sd)

    @property
    def crb(self) -> Float[np.ndarray, " k"]:
        """Cramer-Rao standard errors of the data alone, for white residuals, (k,); infinite where undetermined."""
        scale = np.sqrt(np.diag(self.information))
        known = scale > 0.0
        found = np.full(len(scale), np.inf)
        part = self.information[np.ix_(known, known)] / np.outer(scale[known], scale[known])
        values, vectors = np.linalg.eigh(part)
        if len(values) and values[0] > SINGULAR:
            found[known] = np.sqrt(np.diag((vectors / values) @ vectors.T)) / scale[known]
        return found

    @cached_property
    def corrected(self) -> Float[np.ndarray, "k k"]:
        """Covariance with the residuals' autocorrelation and the priors, shape (k, k); segments are independent.

        With D = `covariance` it is D (M + P) D: M the scores' covariance under the residuals' autocovariance, P that
        of the priors. Sources: Maine and Iliff, NASA RP-1077 (1981); Morelli and Klein, J. Aircraft 1997. M is scaled
        by `calibration`: for what the fit took out of the residuals, and for 1.96 standard errors to hold 95 %.
        """
        if not math.isfinite(self.cost):
            return self.covariance
        k, inside = len(self.estimate), self.flown.inside
        S, own, residual = self.columns[..., 1 : k + 1], self.columns[..., k + 1 :], self.columns[..., 0]
        S = S - np.einsum("wncs,wsk->wnck", own, self.eliminated)  # at optimal initial states
        segment = np.nonzero(inside)[0]
        start = np.diff(segment, prepend=-1) != 0
        D, weight = self.covariance, self.priors.weight
        said = np.diag(self.priors.precision)
        said = said + np.einsum("wsa,s,wsb->ab", self.eliminated, self.priors.states, self.eliminated)
        spread = corrected_covariance(D, S[inside], self.R, residual[inside], segment, start)
        dt = float(np.median(self.flown.dt))
        size = min(max(1, round(BLOCK / dt)), inside.shape[1])
        precision = np.where(self.priors.fixed, np.inf, self.priors.states)
        fit = LinearFit(D, means(S, size), means(own, size), precision, self.R / size, means(inside, size) > 0.0)
        wider = np.sqrt(calibration(fit, means(residual, size), size * dt))
        return weight * D @ said @ D + spread * np.outer(wider, wider)

    @property
    def sd_corrected(self) -> Float[np.ndarray, " k"]:
        """Standard errors with priors, corrected for autocorrelated residuals, (k,); infinite where undetermined."""
        return self._finite_if_determined(np.sqrt(np.diag(self.corrected)))

    @property
    def inseparable(self) -> tuple[Inseparable, ...]:
        """Sets of parameters that the record, with the priors, cannot separate."""
        units = tuple(p.unit for p in self.parameters)
        return inseparable(self.names, units, self.estimate, self.covariance, self.sd_corrected)

    @property
    def thinned_columns(self) -> Float[np.ndarray, "w m c j"]:
        """Means of residuals and sensitivities over `THINNING` samples."""
        w, n, c, j = self.columns.shape
        whole = n // THINNING * THINNING
        return self.columns[:, :whole].reshape(w, -1, THINNING, c, j).mean(axis=2)

    @property
    def held_by_prior(self) -> tuple[str, ...]:
        """Parameters on which the record has little information, so that the prior decides."""
        with np.errstate(divide="ignore"):
            prior = self.priors.precision**-0.5
        return tuple(n for n, sd, own in zip(self.names, self.sd, prior, strict=True) if sd > PRIOR_RATIO * own)


def result_at(
    flown: SegmentTrajectories,
    point: Point,
    prior: NormalPriors,
    *,
    converged: bool,
    iterations: int,
    active: np.ndarray,
    held: np.ndarray,
) -> OutputErrorResult:
    """The result at a point; `held` parameters have no standard error, `active` ones are at a bound."""
    w, s = point.departure.shape
    A, eliminated = np.diag(prior.precision), np.zeros((w, s, len(point.theta)))
    if math.isfinite(point.cost):
        found, _, states = reduced_equations(point, prior)
        informed = (np.diag(found) > 0.0) | (prior.precision > 0.0)  # a parameter without prior may have no information
        part = found[np.ix_(informed, informed)]
        size = np.diag(part)  # rounding may make the matrix of an unstable flight indefinite
        if np.all(size > 0.0) and np.linalg.eigvalsh(part / np.sqrt(np.outer(size, size)))[0] > INDEFINITE:
            A, eliminated = found, states.inverse @ states.cross
    free = flown.dynamics.free
    at_bound = tuple(p.name for p, a in zip(free, active & ~held, strict=True) if a)
    if point.products.inside < 1.0:
        status = OutputErrorStatus.LEFT_ENVELOPE
    elif not converged:
        status = OutputErrorStatus.NOT_CONVERGED
    else:
        status = OutputErrorStatus.AT_BOUND if at_bound else OutputErrorStatus.CONVERGED
    columns = np.concatenate(point.products.columns)[:w]
    residual = columns[..., 0] * flown.noise_growth
    bare, size = ~held & (prior.precision == 0.0), np.diag(A)
    lost, informed = bare & (size <= 0.0), np.flatnonzero(bare & (size > 0.0))
    if len(informed):  # those in singular directions of an information matrix without priors
        scale = np.sqrt(size[informed])
        values, vectors = np.linalg.eigh(A[np.ix_(informed, informed)] / np.outer(scale, scale))
        lost[informed] = np.max(np.abs(vectors[:, values < SINGULAR]), axis=1, initial=0.0) > MIN_COMPONENT
    known = ~held & ~lost
    moving = np.ix_(known, known)
    scale = np.sqrt(np.diag(A)[known])
    covariance = np.zeros_like(A)
    covariance[moving] = np.linalg.pinv(A[moving] / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return OutputErrorResult(
        flown=flown,
        parameters=free,
        estimate=point.theta,
        departure=point.departure,
        R=point.R,
        cost=point.cost,
        covariance=covariance,
        information=A - np.diag(prior.precision),
        priors=prior,
        rms=np.sqrt(np.sum(residual**2, axis=1) / np.maximum(point.products.count, 1.0)[:, None]),
        status=status,
        iterations=iterations,
        at_bound=at_bound,
        columns=columns,
        eliminated=eliminated,
        undetermined=tuple(p.name for p, unknown in zip(free, lost, strict=True) if unknown),
    )
