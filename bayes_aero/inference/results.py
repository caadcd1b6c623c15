"""Results of fits as plain data: estimates, standard errors, a status, scores, warnings."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.sparse.csgraph import connected_components

from bayes_aero.arrays import AnyArray
from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.records import Forming
from bayes_aero.parameter import Parameter, Role
from bayes_aero.units import number

if TYPE_CHECKING:  # they load JAX, which checks of records do without
    import xarray as xr

    from bayes_aero.model.model import Model
    from bayes_aero.model.observations import Colour, Observations

OfEach = Float[np.ndarray, " k"]
OfPairs = Float[np.ndarray, "k k"]
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
class Estimates:
    """Estimates of k parameters, in SI and radians; arrays follow `parameters`.

    `covariance` (k, k) is that of Cramer and Rao, for white residuals; `corrected` (k, k) counts their autocorrelation
    and varying size, and the squared `bias` (k,) from recording noise, which is subtracted from `estimate`; None: not
    computed.
    """

    parameters: tuple[Parameter, ...]
    estimate: OfEach
    covariance: OfPairs
    corrected: OfPairs

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Their SI units."""
        return tuple(p.unit for p in self.parameters)

    @property
    def crb(self) -> OfEach:
        """Cramer-Rao standard errors, shape (k,); they assume white residuals."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def crb_corrected(self) -> OfEach:
        """Standard errors with the residuals' autocorrelation and varying size, shape (k,)."""
        return np.sqrt(np.diag(self.corrected))


@dataclass(frozen=True)
class MleResult(Estimates):
    """A maximum-likelihood fit; `corrected` is over `blocks` blocks of 0.2 s.

    `R` (3,) are the residual variances of CL, CD, Cm, `eigenvalues` (k,) those of the information matrix scaled to unit
    diagonal, `separation` the range of X. `fit` and `lag1` are by coefficient, `starts` the cost and status of each
    start. `active_bounds` are parameters at their bounds, `conflicts` priors that the record contradicts.
    """

    R: Float[np.ndarray, " c"]
    status: MleStatus
    iterations: int
    at_bound: tuple[str, ...]
    eigenvalues: OfEach
    separation: tuple[float, float]
    fit: dict[str, Scores]
    lag1: dict[str, float]
    starts: tuple[tuple[float, str], ...]
    active_bounds: tuple[ActiveBound, ...] = ()
    conflicts: tuple[PriorConflict, ...] = ()
    blocks: int | None = None
    bias: OfEach | None = None

    @property
    def det_R(self) -> float:
        """Determinant of the diagonal residual covariance (order CL, CD, Cm)."""
        return float(np.prod(self.R))

    @property
    def correlation(self) -> OfPairs:
        """Correlation of the estimates from the Cramer-Rao covariance, shape (k, k)."""
        return self.covariance / np.outer(self.crb, self.crb)

    @property
    def inseparable(self) -> tuple[Inseparable, ...]:
        """Sets of parameters that the record cannot separate."""
        return inseparable(self.names, self.units, self.estimate, self.covariance, self.crb_corrected)

    def strong_correlations(self, limit: float = 0.9) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose estimates are correlated beyond `limit` in size."""
        pairs = zip(*np.triu_indices(len(self.names), 1), strict=True)
        strong = [(self.names[i], self.names[j], float(self.correlation[i, j])) for i, j in pairs]
        return sorted((pair for pair in strong if abs(pair[2]) > limit), key=lambda pair: -abs(pair[2]))

    def warnings(self) -> list[str]:
        """Warnings for the user of the numbers, one sentence each."""
        sentences = [] if self.status is MleStatus.CONVERGED else [f"Maximum likelihood: {self.status.value}."]
        if self.blocks is not None and self.blocks < FEWEST_BLOCKS * len(self.names):
            sentences.append(
                f"The record is too short for reliable intervals: it has {self.blocks} blocks of 0.2 s for "
                f"{len(self.names)} parameters; at least {FEWEST_BLOCKS} for each are needed; add manoeuvres or fix "
                "parameters."
            )
        low, high = self.separation
        breaks = [p.name for p in self.parameters if p.role is Role.BREAK_ANGLE]
        if breaks and low > 0.5:
            shape = [p.name for p in self.parameters if p.role in (Role.ABRUPTNESS, Role.BREAK_ANGLE)]
            sentences.append(
                f"The angle of attack never approached {' or '.join(breaks)}: X stays between {low:.2f} and "
                f"{high:.2f}; {', '.join(shape)} and the terms with 1 - X depend on the onset of separation alone."
            )
        for name, value, bound in zip(self.names, self.estimate, self.crb, strict=True):
            if bound > 0.5 * abs(value):
                size = f"{number(bound, 2)}, its estimate {number(value, 2)}"
                if bound < 10.0 * abs(value):  # at a bound of zero a share of the estimate is infinite
                    size = f"{bound / abs(value):.0%} of it"
                sentences.append(f"{name} is not identified: its Cramer-Rao standard error is {size}.")
        biases = () if self.bias is None else zip(self.names, self.bias, self.crb_corrected, strict=True)
        sentences += [
            f"Noise of the recorded signals biases {name} by {number(error, 2)}, most of its corrected standard error; "
            "the bias is subtracted to first order only. Records with less noise are needed."
            for name, error, sd in biases
            if abs(error) > LARGE_BIAS * sd
        ]
        sentences += [f"{a} and {b} are correlated by {value:+.3f}." for a, b, value in self.strong_correlations()]
        return sentences


# --- Restraints on estimates: priors that the data contradict, and active bounds.

CONFLICT_LIMIT = 3.0  # combined standard errors between prior and likelihood, beyond which a conflict is named
MIN_SHIFT = 1.0  # corrected standard errors; smaller changes of other estimates by a bound are not reported


@dataclass(frozen=True)
class PriorConflict:
    """A prior that the record contradicts."""

    name: str
    unit: str
    prior: tuple[float, float]  # mean, standard deviation
    likelihood: tuple[float, float]  # the estimate by likelihood alone, standard error
    distance: float  # in combined standard errors
    source: str


@dataclass(frozen=True)
class ActiveBound:
    """A parameter at its bound."""

    name: str
    unit: str
    bound: float
    lower: bool
    unbounded: float  # the estimate without the bound, to first order
    shifts: Mapping[str, float]  # of the other estimates without it, in corrected standard errors, to first order


# --- Parameters that a record cannot separate: it determines a combination of them, but none by itself.
# Source: Belsley, Kuh and Welsch, Regression Diagnostics (1980), ch. 3 (condition indices and proportions of
# variance); so Klein and Morelli, Aircraft System Identification (2006), sec. 5.2.

INDEX = 10.0  # condition index from which a near dependency counts (there: 5 to 10 weak, beyond 30 strong)
VARIANCE_SHARE = 0.5  # share of a parameter's variance due to near dependencies from which it belongs to one
MIN_WIDENING = 3.0  # factor by which the unknown others widen an interval from which it is reported; our choice
MIN_PARTIAL = 0.5  # partial correlation of two estimates from which they share a dependency; our choice
MAX_RELATIVE_ERROR = 0.2  # standard error over estimate from which an estimate is of little use; our choice


@dataclass(frozen=True)
class Inseparable:
    """Parameters in one near dependency, the one with the largest variance inflation first."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    estimates: tuple[tuple[float, float], ...]  # with corrected standard errors
    wider: tuple[float, ...]  # factor by which the unknown others widen each interval


def inseparable(
    names: Sequence[str], units: Sequence[str], estimate: OfEach, covariance: OfPairs, deviation: OfEach
) -> tuple[Inseparable, ...]:
    """Sets of parameters that the record cannot separate, at least one of them with a large relative error."""
    # The set with the largest variance inflation comes first. `covariance` of Cramer and Rao: a parameter without
    # variance is known. `deviation`: standard errors corrected for autocorrelated residuals.
    if not np.isfinite(covariance).all():
        return ()
    white = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    free = np.flatnonzero((white > 0.0) & np.isfinite(deviation))
    if len(free) < 2:
        return ()
    correlation = covariance[np.ix_(free, free)] / np.outer(white[free], white[free])
    information = np.linalg.pinv(correlation, rcond=1e-13, hermitian=True)
    inflation = np.maximum(np.diag(information), 1.0)
    partial = information / np.sqrt(np.outer(inflation, inflation))  # of unit diagonal: but for signs, correlations
    values, vectors = np.linalg.eigh(partial)
    shares = vectors**2 / np.maximum(values, 1e-13)
    shares = shares / shares.sum(axis=1, keepdims=True)
    vague = deviation > MAX_RELATIVE_ERROR * np.abs(estimate)
    near = np.sqrt(values[-1] / np.maximum(values, 1e-13)) > INDEX
    inside = (shares[:, near].sum(axis=1) > VARIANCE_SHARE) & (np.sqrt(inflation) > MIN_WIDENING)
    # Members are connected by their partial correlations: within a dependency of any size these are near one, and the
    # eigenvectors of equally near dependencies are arbitrary mixtures.
    members = np.array([i for i in np.argsort(-inflation) if inside[i]], int)
    if not len(members):
        return ()
    _, label = connected_components(np.abs(partial)[np.ix_(members, members)] > MIN_PARTIAL, directed=False)
    parts = [members[label == number] for number in dict.fromkeys(label)]
    sets = []
    for part in (part for part in parts if len(part) > 1):
        at = free[part]
        if any(vague[at]):
            sets.append(
                Inseparable(
                    tuple(names[int(i)] for i in at),
                    tuple(units[int(i)] for i in at),
                    tuple((float(estimate[i]), float(deviation[i])) for i in at),
                    tuple(float(np.sqrt(inflation[i])) for i in part),
                )
            )
    return tuple(sets)


# --- What a fit in the frequency domain gives.


@dataclass(frozen=True)
class FrequencyFit(Estimates):
    """Estimates in a band, of the parameters that it shows; lines have one variance, or each its own (`corrected`)."""

    method: str  # equation error or output error
    band: tuple[float, float]  # lowest and highest frequency, Hz
    lines: int  # number of frequencies, of all manoeuvres together
    inner: Mapping[str, OfPairs]  # inner products of the sensitivities by output
    R: Mapping[str, float]  # variance of the residuals by output; white noise has the same at the samples
    unseen: tuple[str, ...]  # free parameters that drop out with bias and drift
    converged: bool
    at_bound: tuple[str, ...] = ()  # parameters that the band would move beyond a bound, and that are held there
    bias: OfEach | None = None
    apart: Mapping[str, float] = field(default_factory=dict)  # from the time domain, in standard errors of that


@dataclass(frozen=True)
class FrequencyResponse:
    """An output over an input at frequencies (f,), Hz; SI."""

    input: str
    output: str
    frequency: Float[np.ndarray, " f"]
    measured: Complex[np.ndarray, " f"]  # by cross spectra
    error: Float[np.ndarray, " f"]  # standard error
    coherence: Float[np.ndarray, " f"]  # of the output with all inputs
    modelled: Complex[np.ndarray, " f"]  # by the estimates in the band
    draws: Complex[np.ndarray, "d f"]  # by draws of them


# --- A sampled posterior: draws as an ArviZ DataTree, diagnostics, a status.


class PosteriorStatus(Enum):
    """Whether the draws may be used; the value is the text for the user."""

    CONVERGED = "converged"
    NOT_CONVERGED = (
        "not converged: R-hat or effective sample size missed its target; run longer, do not use the intervals"
    )
    DIVERGENT = "divergent transitions: the sampler could not follow the posterior; its tails are not trusted"


@dataclass(frozen=True)
class Marginal:
    """One parameter's posterior: mean, standard deviation, equal-tailed 95 % interval and diagnostics."""

    mean: float
    sd: float
    ci95: tuple[float, float]
    ess_bulk: float
    ess_tail: float
    rhat: float

    @property
    def ess(self) -> float:
        """Effective sample size of centre or tails, whichever is smaller."""
        return min(self.ess_bulk, self.ess_tail)


@dataclass(frozen=True)
class Posterior:
    """Draws of one sampler, in SI and radians.

    Attributes:
        engine: `emcee` or `nuts`.
        noise: noise model.
        names: the k parameters.
        tree: groups posterior, sample_stats, log_likelihood, prior, posterior_predictive and prior_predictive.
        marginals: by parameter.
        status: whether the draws may be used.
        seconds: run time, s.
    """

    engine: str
    noise: str
    names: tuple[str, ...]
    tree: xr.DataTree
    marginals: dict[str, Marginal]
    status: PosteriorStatus
    seconds: float

    def draws(self, names: Sequence[str] | None = None) -> Float[np.ndarray, "m k"]:
        """All draws, shape (m, k): chains one after the other, columns as these `names` (default: all)."""
        posterior = self.tree["posterior"].to_dataset()
        return np.stack([np.asarray(posterior[name]).reshape(-1) for name in names or self.names], axis=1)

    def most_correlated(self, count: int) -> list[str]:
        """Names, in their order, of the `count` parameters whose largest correlation with another is largest."""
        size = np.abs(np.corrcoef(self.draws().T)) - np.eye(len(self.names))
        chosen = set(np.argsort(-size.max(axis=1), kind="stable")[:count].tolist())
        return [name for i, name in enumerate(self.names) if i in chosen]

    def save(self, path: Path) -> None:
        """Write `tree` to `path` as NetCDF, whole or not at all."""
        encoding = {
            f"/{group}": {name: {"zlib": True, "complevel": 4} for name in node.data_vars}
            for group, node in self.tree.children.items()
            if group in ("log_likelihood", "posterior_predictive", "prior_predictive")
        }
        write_whole(self.tree.to_netcdf(engine="h5netcdf", encoding=encoding), path)


# --- What manoeuvres say of the next flight: the aircraft, the scatter between manoeuvres, each manoeuvre pooled.


@dataclass(frozen=True)
class NextFlight:
    """Partial pooling of manoeuvres, in SI and radians.

    Every manoeuvre enters by the normal approximation of its own fit. Where the prior is lognormal, the logarithm
    scatters, and `scatter` is that times the aircraft's value.
    """

    parameters: tuple[Parameter, ...]
    manoeuvres: tuple[str, ...]  # those that count
    alone: dict[str, dict[str, tuple[float, float]]]  # estimate, corrected standard error: what a record determines
    pooled: dict[str, dict[str, Marginal]]  # by manoeuvre and parameter
    aircraft: dict[str, Marginal]  # the value around which manoeuvres scatter
    scatter: dict[str, Marginal]  # standard deviation between manoeuvres
    following: dict[str, Marginal]  # the value in a flight not yet flown
    narrowed: dict[str, float]  # deviation of the scatter over its prior's: 1 where the records say nothing of it
    undetermined: dict[str, tuple[str, ...]]  # the manoeuvres whose records say less of it than the prior
    left_out: dict[str, str]  # manoeuvres without a usable fit, with the reason
    tree: xr.DataTree  # groups `posterior` (aircraft, scatter, next_flight, manoeuvre) and `sample_stats`
    status: PosteriorStatus  # whether the draws of the scatter may be used
    seconds: float  # run time

    @property
    def at_best(self) -> tuple[float, float]:
        """95 % interval of the scatter over the estimates' own, were each manoeuvre known exactly (chi-square)."""
        free = len(self.manoeuvres) - 1
        from scipy.stats import chi2  # here, because it loads for longer than a check takes

        low, high = (float((free / chi2.ppf(q, free)) ** 0.5) for q in (0.975, 0.025))
        return low, high

    def save(self, path: Path) -> None:
        """Write the draws to `path` as NetCDF, whole or not at all."""
        write_whole(self.tree.to_netcdf(engine="h5netcdf"), path)


# --- Results of one identification run, from which reports are written.


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
    fits: dict[str, Any]  # `GPFit` of the chosen split's first fold
    chosen: str
    seconds: float
    left_out: tuple[str, ...] = ()  # which splits the records do not allow, and why

    def pooled(self, split: str, name: str) -> Validation:
        """A coefficient at the test points of all folds: scores of all, coverage by points, the largest `k_hat`."""
        folds = [fold[name] for fold in self.splits[split]]
        keys = ("test", "measured", "gp", "gp_low", "gp_high", "mle")
        every = {key: np.concatenate([getattr(v, key) for v in folds]) for key in keys}
        by = {level: [v.coverage[level] for v in folds] for level in folds[0].coverage}
        return Validation(
            **every,
            gp_scores=score(every["measured"], every["gp"]),
            mle_scores=score(every["measured"], every["mle"]),
            coverage={x: float(np.average(by[x], weights=[len(v.measured) for v in folds])) for x in by},
            k_hat=max((v.k_hat for v in folds if v.k_hat is not None), default=None),
            status="; ".join(dict.fromkeys(v.status for v in folds)),
        )


@dataclass(frozen=True)
class Interval:
    """Median and equal-tailed 95 % interval."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: Float[np.ndarray, " m"]) -> Interval:
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
        return np.asarray(self.model.predicted(np.asarray(self.mle.estimate), o.signals, o.aircraft))


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


# --- Scores of predictions against measurements: the four numbers and the coverages of the validation table, and the
# calibration of one-step predictions.

Vector = Float[AnyArray, " n"]
OfPoints = Float[AnyArray, " points"]  # its length is checked in words
COLOURED_INNOVATIONS = 0.3  # correlation of neighbouring innovations beyond which something is not modelled; our choice


@dataclass(frozen=True)
class Scores:
    """Scores of one predicted channel against its measurement.

    `r` is Pearson's correlation, `rmse` has the unit of the channel, `theil` is Theil's
    inequality coefficient rms(z - y)/(rms z + rms y) (0 perfect, 1 worst), `r2` is 1 - SSE/SST. A score that
    does not exist, because the measurement or the prediction does not vary, is NaN.
    """

    r: float
    rmse: float
    theil: float
    r2: float


class Calibration(enum.Enum):
    """Whether predictions are calibrated, and what is wrong if not."""

    CALIBRATED = "calibrated"
    TOO_NARROW = "too_narrow"
    TOO_WIDE = "too_wide"
    NOT_NORMAL = "not_normal"  # too narrow at one level, too wide at another
    COLOURED = "coloured"  # correct on average, but autocorrelated
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Share:
    """Share of the innovations inside a central predictive interval."""

    level: float  # probability of the interval
    share: float
    sd: float  # standard error, with the autocorrelation counted
    p: float  # p-value of calibrated predictions, with the autocorrelation counted


@dataclass(frozen=True)
class Predicted:
    """One-step predictions of one output, or of all outputs together."""

    count: int  # of innovations
    rms: float | None  # of measured minus predicted from the samples before, SI; None of all together
    ratio: tuple[float, float]  # rms of innovations over predicted standard deviations (1: calibrated); standard error
    shares: tuple[Share, ...]  # inside central intervals, by level
    calibration: Calibration  # by the shares and the autocorrelation
    # As rows: normal score, quantile of the innovations over their predicted standard deviations, and the band that
    # contains all quantiles of calibrated predictions with a probability of 95 %.
    quantiles: Float[np.ndarray, "m 4"]


@dataclass(frozen=True)
class OneStep:
    """One-step predictions by output, and those of all outputs together."""

    outputs: Mapping[str, Predicted]
    together: Predicted

    @property
    def status(self) -> str:
        """`calibrated`, `not_calibrated`, or `undecided` where there are too few innovations to tell."""
        verdicts = {one.calibration for one in (*self.outputs.values(), self.together)}
        if verdicts == {Calibration.CALIBRATED}:
            return "calibrated"
        return "undecided" if verdicts <= {Calibration.CALIBRATED, Calibration.UNDECIDED} else "not_calibrated"


def score(measured: Vector, predicted: OfPoints) -> Scores:
    """Scores of `predicted` (n,) against `measured` (n,), both in the unit of the channel."""
    z, y = np.asarray(measured, float), np.asarray(predicted, float)
    if z.ndim != 1 or z.shape != y.shape or z.size < 2:
        raise InputError(f"Measured {z.shape} and predicted {y.shape} must be vectors of one length >= 2.")
    for name, x in (("measured", z), ("predicted", y)):
        if not np.all(np.isfinite(x)):
            at = int(np.flatnonzero(~np.isfinite(x))[0])
            raise InputError(f"The {name} channel is not finite at sample {at}; remove or repair that sample.")
    rmse, rms_z, rms_y = (float(np.sqrt(np.mean(np.square(x)))) for x in (z - y, z, y))
    theil = rmse / (rms_z + rms_y) if rms_z + rms_y > 0 else 0.0
    # A spread below the rounding of the values themselves is no spread.
    z_varies, y_varies = (np.ptp(x) > 8 * np.finfo(float).eps * np.max(np.abs(x)) for x in (z, y))
    r2 = 1.0 - float(np.sum((z - y) ** 2) / np.sum((z - z.mean()) ** 2)) if z_varies else float("nan")
    r = float(np.corrcoef(z, y)[0, 1]) if z_varies and y_varies else float("nan")
    return Scores(r, rmse, theil, r2)
