"""The result of a maximum-likelihood fit of the coefficients: estimates, Cramer-Rao bounds, a status, warnings."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float

from bayes_aero.inference.likelihood.restraints import ActiveBound, PriorConflict
from bayes_aero.inference.scores import Scores
from bayes_aero.inference.variance.inseparable import Inseparable, inseparable
from bayes_aero.parameter import Parameter, Role
from bayes_aero.units import number

FEWEST_BLOCKS = 10  # of 0.2 s for each parameter, below which a record is too short for intervals; our choice
LARGE_BIAS = 0.75  # of the corrected standard error, which contains the bias


class MleStatus(Enum):
    """How the fit ended; the value is the text for the user."""

    CONVERGED = "converged"
    AT_BOUND = "converged with a parameter at its bound: its interval is not reliable; widen the bound or fix it"
    NOT_CONVERGED = "stopped before the optimum: start nearer, add priors or fix parameters; do not use the numbers"
    SINGULAR = "the information matrix is singular: the record does not identify every parameter; fix or add data"
    STALL_NOT_IDENTIFIED = (
        "every start ended where the flow is never, or always, separated: the record does not identify the stall; "
        "add a manoeuvre that stalls, or fix the parameters of the separation"
    )


@dataclass(frozen=True)
class MleResult:
    """A maximum-likelihood fit of k parameters, in SI and radians; arrays follow `parameters`.

    `covariance` (k, k) is that of Cramer and Rao, for white residuals; `corrected` (k, k) counts their autocorrelation
    over `blocks` blocks of 0.2 s. `R` (3,) are the residual variances of CL, CD, Cm, `eigenvalues` (k,) those of the
    information matrix scaled to unit diagonal, `separation` the range of X. `fit` and `lag1` are by coefficient,
    `starts` the cost and status of each start. `active_bounds` are parameters at their bounds, `conflicts` priors that
    the record contradicts. `bias` (k,) from recording noise is subtracted from `estimate`; None: not computed.
    """

    parameters: tuple[Parameter, ...]
    estimate: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    corrected: Float[np.ndarray, "k k"]
    R: Float[np.ndarray, " c"]
    status: MleStatus
    iterations: int
    at_bound: tuple[str, ...]
    eigenvalues: Float[np.ndarray, " k"]
    separation: tuple[float, float]
    fit: dict[str, Scores]
    lag1: dict[str, float]
    starts: tuple[tuple[float, str], ...]
    active_bounds: tuple[ActiveBound, ...] = ()
    conflicts: tuple[PriorConflict, ...] = ()
    blocks: int | None = None
    bias: Float[np.ndarray, " k"] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Their SI units."""
        return tuple(p.unit for p in self.parameters)

    @property
    def det_R(self) -> float:
        """Determinant of the diagonal residual covariance (order CL, CD, Cm)."""
        return float(np.prod(self.R))

    @property
    def crb(self) -> Float[np.ndarray, " k"]:
        """Cramer-Rao standard errors, shape (k,); they assume white residuals."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def crb_corrected(self) -> Float[np.ndarray, " k"]:
        """Standard errors with the residuals' autocorrelation and varying size (`robust_covariance`), shape (k,)."""
        return np.sqrt(np.diag(self.corrected))

    @property
    def correlation(self) -> Float[np.ndarray, "k k"]:
        """Correlation of the estimates from the Cramer-Rao covariance, shape (k, k)."""
        return self.covariance / np.outer(self.crb, self.crb)

    @property
    def inseparable(self) -> tuple[Inseparable, ...]:
        """Sets of parameters that the record cannot separate."""
        return inseparable(self.names, self.units, self.estimate, self.covariance, self.crb_corrected)

    def strong_correlations(self, limit: float = 0.9) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose estimates are correlated beyond `limit` in size."""
        rows, columns = np.triu_indices(len(self.names), 1)
        pairs = (
            (self.names[i], self.names[j], float(self.correlation[i, j])) for i, j in zip(rows, columns, strict=True)
        )
        return sorted((pair for pair in pairs if abs(pair[2]) > limit), key=lambda pair: -abs(pair[2]))

    def warnings(self) -> list[str]:
        """Warnings for the user of the numbers, one sentence each."""
        sentences = [] if self.status is MleStatus.CONVERGED else [f"Maximum likelihood: {self.status.value}."]
        if self.blocks is not None and self.blocks < FEWEST_BLOCKS * len(self.names):
            sentences.append(
                f"The record is too short for reliable intervals: it has {self.blocks} blocks of 0.2 s for "
                f"{len(self.names)} parameters, and at least {FEWEST_BLOCKS} for each parameter are needed; add "
                "manoeuvres or fix parameters."
            )
        low, high = self.separation
        breaks = [p.name for p in self.parameters if p.role is Role.BREAK_ANGLE]
        if breaks and low > 0.5:
            shape = [p.name for p in self.parameters if p.role in (Role.ABRUPTNESS, Role.BREAK_ANGLE)]
            sentences.append(
                f"The angle of attack never approached {' or '.join(breaks)}: X stays between {low:.2f} and "
                f"{high:.2f}, so {', '.join(shape)} and the terms with 1 - X depend on the onset of separation alone."
            )
        for name, value, bound in zip(self.names, self.estimate, self.crb, strict=True):
            if bound > 0.5 * abs(value):
                near = bound < 10.0 * abs(value)  # at a bound of zero a share of the estimate is infinite
                size = (
                    f"{bound / abs(value):.0%} of it"
                    if near
                    else f"{number(bound, 2)}, its estimate {number(value, 2)}"
                )
                sentences.append(f"{name} is not identified: its Cramer-Rao standard error is {size}.")
        bias = np.zeros(len(self.names)) if self.bias is None else self.bias
        for name, error, sd in zip(self.names, bias, self.crb_corrected, strict=True):
            if abs(error) > LARGE_BIAS * sd:
                sentences.append(
                    f"Noise of the recorded signals biases {name} by {number(error, 2)}, most of its corrected "
                    "standard error; the bias is subtracted to first order only. Records with less noise are needed."
                )
        sentences += [f"{a} and {b} are correlated by {value:+.3f}." for a, b, value in self.strong_correlations()]
        return sentences
