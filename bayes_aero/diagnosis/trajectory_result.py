"""What simulated trajectories show, and what is shown of a diagnosis, as plain data.

Errors by flight, estimates, tests of effects, a fit by itself; both models of a diagnosis, rankings, hold-out scores.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.accuracy import Confirmation
from bayes_aero.diagnosis.candidate_set import DEFAULT
from bayes_aero.diagnosis.result import NOT_NOISE, Diagnosis
from bayes_aero.diagnosis.selection_state import RegressionFit, SelectionState
from bayes_aero.dynamics.flight import AircraftDynamics, PathDynamics, unbiased
from bayes_aero.inference.output_error import OutputErrorResult, initial_state_sd
from bayes_aero.inference.results import FrequencyFit, FrequencyResponse, OneStep, OutputErrorStatus, Scores, Stall
from bayes_aero.parameter import Parameter

START, FITTED = "start", "fitted"


@dataclass(frozen=True)
class TheilParts:
    """Theil's inequality coefficient and the shares of bias, variance and covariance in the mean square error."""

    # Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 11; the shares add up to one.

    theil: float
    bias: float
    variance: float
    covariance: float


def theil_parts(measured: Float[np.ndarray, " n"], modelled: Float[np.ndarray, " n"]) -> TheilParts:
    """U = rms(z - y)/(rms z + rms y); shares (mean z - mean y)^2, (sd z - sd y)^2, 2(1 - r) sd z sd y of the MSE."""
    z, y = np.asarray(measured), np.asarray(modelled)
    mse = float(np.mean((z - y) ** 2))
    if mse == 0.0:
        return TheilParts(0.0, 0.0, 0.0, 0.0)
    sz, sy = z.std(), y.std()
    covariance = float(np.mean((z - z.mean()) * (y - y.mean())))
    theil = np.sqrt(mse) / (np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2)))
    parts = ((z.mean() - y.mean()) ** 2, (sz - sy) ** 2, 2.0 * (sz * sy - covariance))
    return TheilParts(float(theil), *(float(part / mse) for part in parts))


@dataclass(frozen=True)
class Error:
    """One output of one manoeuvre: root mean square and largest error (SI), Theil's coefficient and its parts."""

    rms: float
    largest: float
    theil: TheilParts
    tolerance: float | None
    within: float | None  # share of samples inside the tolerance
    probability: float | None  # the posterior's that all of them are


@dataclass(frozen=True)
class SimulatedManoeuvre:
    """One simulated manoeuvre."""

    manoeuvre: str
    # card or extended; of a fit by itself (`fit_trajectories`) start or fitted, of parameters from elsewhere given
    model: str
    split: str  # fitted (jointly, initial state too) or hold_out (from the measured state); else as the model
    inside: bool  # the flight envelope
    errors: Mapping[str, Error]
    time: Float[np.ndarray, " n"]
    measured: Mapping[str, np.ndarray]
    simulated: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class LagTest:
    """The test of a separation lag: gains in log density, divided by the variance inflation."""

    effect: str
    gain: float  # of the joint fit
    kept: bool = False  # hold-out flights confirm the lag
    unseen: tuple[float, float] = (float("nan"), float("nan"))  # on hold-out flights; NaN where `gain` is too little
    instead: tuple[str, ...] = ()  # parameters of hysteresis that it replaces
    slight: bool = False  # too small to be named
    decisive: float = DEFAULT.decisive  # nats that the joint fit must gain

    @property
    def gains(self) -> bool:
        """Whether the joint fit gains enough by it that the hold-out test is worth running."""
        return self.gain > self.decisive and not self.slight


@dataclass(frozen=True)
class TrajectoryEstimates:
    """One model as fitted to all trajectories: its parameters (SI) by name, and how the fit ended."""

    values: Mapping[str, float]
    units: Mapping[str, str]
    status: OutputErrorStatus
    at_bound: tuple[str, ...]
    held: tuple[str, ...]  # by their priors: the trajectories say next to nothing of them

    @classmethod
    def of(cls, fit: OutputErrorResult, gone: Collection[str] = ()) -> TrajectoryEstimates:
        """The estimates of a fit without the parameters that are `gone`."""
        values = {n: float(x) for n, x in zip(fit.names, fit.estimate, strict=True) if n not in gone}
        units = {p.name: p.unit for p in fit.parameters if p.name in values}
        return cls(values, units, fit.status, fit.at_bound, tuple(n for n in fit.held_by_prior if n in values))


@dataclass(frozen=True)
class Trajectories:
    """What simulations say of the card's model and of the extended one."""

    paths: tuple[SimulatedManoeuvre, ...]
    card: TrajectoryEstimates
    extended: TrajectoryEstimates
    deviation: Mapping[str, float]  # of the extended model's parameters, the residuals' colour counted
    variance_inflation: float  # how many times the colour multiplies variances
    held: Mapping[str, tuple[str, ...]]  # causes held at their joint estimate when a manoeuvre is fitted alone
    fitted: tuple[str, ...]  # outputs
    outputs: tuple[str, ...]  # all that were recorded
    noise_growth: Mapping[str, float] = field(default_factory=dict)  # missed in separated flow, by fitted output
    lag: LagTest | None = None  # of the separation point, if it was tried
    asked: Confirmation = field(default_factory=lambda: Confirmation((), {}))  # of the causes: which flight misses

    @property
    def out(self) -> tuple[str, ...]:
        """Causes that flight does not miss: the extended model flies without them."""
        return tuple(e for e in self.asked.missed if e not in self.asked.kept)

    def path(self, manoeuvre: str, model: str, split: str) -> SimulatedManoeuvre | None:
        """One of the paths."""
        return next((p for p in self.paths if (p.manoeuvre, p.model, p.split) == (manoeuvre, model, split)), None)


@dataclass(frozen=True)
class Setting:
    """How trajectories are fitted: the settings in which published programs differ.

    `outputs` are those that are compared (default: all that are recorded and simulated, but for `LEFT`). `initial`: the
    state in which every manoeuvre begins, SI, and where it names none the first sample; None: initial states are
    fitted. Without `priors` the reported fit has none, of parameters and initial states alike. Inputs are linear
    between samples, or `held`.
    """

    outputs: tuple[str, ...] | None = None
    initial: Mapping[str, float] | None = None
    priors: bool = True
    held: bool = False


@dataclass(frozen=True)
class TrajectoryFit:
    """A fit to whole manoeuvres, in SI and radians.

    Attributes:
        fit: estimates (k,), standard errors and status.
        start: first values of the parameters, (k,).
        paths: simulated manoeuvres of the model `start` (first values, measured initial state) or `fitted`.
        initial: by manoeuvre and state, the value at the first sample and its departure from the measured one.
        variance_inflation: variance inflation of the residuals; NaN if the model left the envelope.
        outputs: all recorded outputs; those fitted are in `fit`.
        units: SI units by channel.
        window: length of the windows of the first fits, s.
        noise_growth: noise growth in fully separated flow, by fitted output.
        setting: settings of the fit.
        frequency: fits of the same parameters in a band, where one was asked for.
        frequency_responses: measured and modelled frequency responses there.
        following: surfaces that only follow the outputs, of which and the aircraft the fit is one of many.
    """

    fit: OutputErrorResult
    start: Float[np.ndarray, " k"]
    paths: tuple[SimulatedManoeuvre, ...]
    initial: Mapping[str, Mapping[str, tuple[float, float]]]
    variance_inflation: float
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    window: float
    noise_growth: Mapping[str, float] = field(default_factory=dict)
    setting: Setting = field(default_factory=Setting)
    frequency: tuple[FrequencyFit, ...] = ()
    frequency_responses: tuple[FrequencyResponse, ...] = ()
    following: tuple[str, ...] = ()

    @property
    def converged(self) -> bool:
        """Whether the fit converged; a parameter may be at its bound."""
        return self.fit.status in (OutputErrorStatus.CONVERGED, OutputErrorStatus.AT_BOUND)

    @property
    def by_effects(self) -> bool:
        """Whether the model is one of effects; otherwise it is a linear system."""
        return isinstance(unbiased(self.fit.flown.dynamics), AircraftDynamics)

    @property
    def of_path(self) -> bool:
        """Whether recorded accelerations and rates were flown, without a model of the aircraft."""
        return isinstance(self.fit.flown.dynamics, PathDynamics)

    @property
    def departure_sd(self) -> dict[str, float]:
        """By state, the prior standard deviation of its departure from the measured one; empty without such priors."""
        dynamics = self.fit.flown.dynamics
        if not self.setting.priors or self.setting.initial is not None:
            return {}
        return dict(zip(dynamics.start, map(float, initial_state_sd(dynamics)), strict=True))

    @property
    def manoeuvres(self) -> tuple[str, ...]:
        """Names of the manoeuvres."""
        return tuple(dict.fromkeys(p.manoeuvre for p in self.paths))

    def path(self, manoeuvre: str, model: str) -> SimulatedManoeuvre:
        """The path of one manoeuvre and model (`start` or `fitted`)."""
        return next(p for p in self.paths if (p.manoeuvre, p.model) == (manoeuvre, model))

    @property
    def rms_errors(self) -> dict[str, tuple[float, float]]:
        """Root mean square error of each output over all manoeuvres, SI: at the first values, and of the fit."""

        def rms(model: str, output: str) -> float:
            paths = [p for p in self.paths if p.model == model]
            samples = np.array([len(p.time) for p in paths])
            return float(np.sqrt(np.average(np.square([p.errors[output].rms for p in paths]), weights=samples)))

        with np.errstate(over="ignore", invalid="ignore"):  # a simulation with the first values may diverge
            return {output: (rms(START, output), rms(FITTED, output)) for output in self.outputs}

    @property
    def worse(self) -> tuple[str, ...]:
        """Outputs most of whose mean square error a fitted flight path has added to that of the record as it is.

        Kinematics has no other errors than those of the sensors: the fit lacks one, and others stand for it.
        """
        if not self.of_path:
            return ()
        errors = self.rms_errors
        fitted = (name for name in self.fit.flown.outputs if name in errors)
        return tuple(n for n in fitted if errors[n][1] ** 2 * (1.0 - NOT_NOISE) > errors[n][0] ** 2)


@dataclass(frozen=True)
class Disagreement:
    """One parameter: estimate and standard error by either fit, `apart` combined standard errors, SI."""

    name: str
    unit: str
    coefficients: tuple[float, float]
    trajectories: tuple[float, float]
    apart: float


@dataclass(frozen=True)
class GustHistory:
    """The gusts that one manoeuvre met, given all of its samples."""

    manoeuvre: str
    time: Float[np.ndarray, " n"]  # s from its start
    gusts: Mapping[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]  # mean and standard deviation, m/s


@dataclass(frozen=True)
class ProcessNoise:
    """A fit with process noise, SI and radians, standard errors for white innovations."""

    status: str  # how the fit ended
    converged: bool  # whether its numbers mean something
    gain: float  # log likelihood beyond that of output error, nats
    estimates: Mapping[str, tuple[float, float]]  # by parameter, each with its standard error
    F: Mapping[str, float]  # process noise by state, unit of the state per square root of a second
    noise_sd: Mapping[str, float]  # standard deviation of the measurement noise by output
    autocorrelation: Mapping[str, float]  # of neighbouring innovations; 0 if the disturbance is as modelled
    # Intensity (m/s) and scale length (m) of each gust, and of buffet (1; chords) where the flow separates, by
    # parameter, with standard errors.
    gusts: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    histories: tuple[GustHistory, ...] = ()  # what was met, by manoeuvre; empty where no gust has an intensity
    one_step: OneStep | None = None  # whether one-step predictions are calibrated; None without convergence
    covariance: Float[np.ndarray, "k k"] | None = None  # of the `estimates`, in their order

    @property
    def preferred(self) -> bool:
        """Whether it describes the record better than output error does."""
        return self.converged and self.gain > 0.0


# --- Modes of motion of a fitted model.

HALF = math.log(2.0)


@dataclass(frozen=True)
class FlownMode:
    """A mode with its uncertainty."""

    name: str  # short period, phugoid, Dutch roll, roll, spiral; other where no name fits
    eigenvalue: complex  # 1/s; of a pair the one of positive imaginary part
    sd: tuple[float, float]  # standard errors of its real and imaginary part, 1/s
    # Period, time_constant, time_to_half and time_to_double in s, damping_ratio; each with its standard error. What the
    # data do not tell apart from none is left out.
    quantities: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Motion:
    """Modes about straight level flight."""

    airspeed: float  # m/s; NaN of linear cards
    altitude: float  # m
    modes: tuple[FlownMode, ...] = ()
    why_not: str = ""  # why there are no modes
    filtered: bool = False  # the modes are of the estimates with process noise, not of output error


# --- What is shown of a diagnosis, as plain data: both models at every sample, rankings, scores on hold-out data.

LEADERS = 10  # candidates of a stage that are listed, by their scores
CONSIDERED = 3  # and by the share of what is left that they explain
LEVELS = (0.5, 0.9, 0.95)


@dataclass(frozen=True)
class ResidualProfile:
    """Mean residual of a coefficient in bins of equal count of a channel, and the deviation of each mean."""

    channel: str
    centre: Float[np.ndarray, " b"]
    mean: Float[np.ndarray, " b"]
    deviation: Float[np.ndarray, " b"]


@dataclass(frozen=True)
class Fitted:
    """One model fitted to all manoeuvres."""

    residual: Float[np.ndarray, "n c"]  # of the coefficients at the recorded rate
    signals: Mapping[str, np.ndarray]  # what explains the coefficients, by name, (n,)
    # By coefficient: scores, Theil's parts, autocorrelation at lag 1 and calibration of the residuals.
    composition: Mapping[str, Mapping[str, Any]]
    profiles: tuple[tuple[ResidualProfile, ...], ...]  # by coefficient, the clearest dependence first
    state: SelectionState  # the regression problem at its optimum
    fit: RegressionFit


@dataclass(frozen=True)
class ParameterMove:
    """A parameter of the card before and after the causes are added; standard errors count the autocorrelation."""

    before: float
    after: float
    sd_before: float
    sd_after: float
    unit: str


@dataclass(frozen=True)
class JointCovariance:
    """Covariance (k, k) of the extended model's estimates, SI, for coloured residuals; `names` (k) are its rows."""

    names: tuple[str, ...]
    matrix: Float[np.ndarray, "k k"]


@dataclass(frozen=True)
class RankedCandidate:
    """One candidate of a stage's first screening, at its best value."""

    effect: str
    kind: str
    score: float
    p_value: float
    explains: float  # share of the remaining variance that it would take away, by which candidates are taken in turn
    estimate: Mapping[str, tuple[float, float]]  # and standard error, by parameter


@dataclass(frozen=True)
class Ranking:
    """Candidates of one stage, the highest score first; `threshold` is what noise alone exceeds in a share `level`."""

    stage: str
    candidate_scores: tuple[RankedCandidate, ...]
    threshold: float
    level: float

    @property
    def leaders(self) -> tuple[RankedCandidate, ...]:
        """Those that tables and figures show: the `LEADERS` highest scores, and what is considered first."""
        first = {s.effect for s in sorted(self.candidate_scores, key=lambda s: -s.explains)[:CONSIDERED]}
        return tuple(s for k, s in enumerate(self.candidate_scores) if k < LEADERS or s.effect in first)


@dataclass(frozen=True)
class Compared:
    """What one model gains on another in one coefficient of one manoeuvre, unseen; each with its deviation."""

    elpd: float  # log density, nats, the colour's cost counted, where noise grows with separated flow as it was found
    elpd_sd: float
    r2: float  # difference of R2, which weighs every sample alike and so hangs on the few of the deepest stall
    r2_sd: float


@dataclass(frozen=True)
class HoldoutScores:
    """Both models on each manoeuvre, in the fit and on hold-out data (means over blocks of about 5 Hz)."""

    names: tuple[str, ...]  # of the manoeuvres
    # Of each coefficient, by model (`card`, `extended`), data (`fitted`, `hold_out`) and the manoeuvre's number.
    scores: Mapping[tuple[str, str, int], Mapping[str, Scores]]
    gains: Mapping[tuple[str, str], Compared]  # of the extended model, on hold-out data, by manoeuvre and coefficient
    hold_out: float  # standard errors of a loss that is significant

    def worse(self) -> list[tuple[str, str]]:
        """Manoeuvres and coefficients for which the extended model loses log density significantly (one-sided, 5 %)."""
        return [pair for pair, gain in self.gains.items() if gain.elpd < -self.hold_out * gain.elpd_sd]


@dataclass(frozen=True, kw_only=True)
class DiagnosisView:
    """A diagnosis with what is derived from it, by coefficients (see `View`) or by trajectories alone."""

    diagnosis: Diagnosis
    rankings: tuple[Ranking, ...]
    moves: Mapping[str, ParameterMove]
    covariance: JointCovariance | None = None
    trajectories: Trajectories | None = None

    @property
    def unseen_scores(self) -> tuple[Mapping[str, Scores], Mapping[str, Scores]] | None:
        """Scores of each coefficient on hold-out data: the card's model, and with all causes that are confirmed."""
        measured = [c.gain for c in self.diagnosis.causes if c.gain.before]
        if not measured:
            return None
        confirmed = [c.gain for c in self.diagnosis.causes if c.gain.before and c.confirmed]
        return measured[0].before, confirmed[-1].after if confirmed else measured[0].before


@dataclass(frozen=True, kw_only=True)
class View(DiagnosisView):
    """A diagnosis by coefficients."""

    card: Fitted
    extended: Fitted
    measured: Float[np.ndarray, "n c"]  # coefficients that the card reconstructs
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]  # from the start of each manoeuvre, s
    names: tuple[str, ...]
    channels: Mapping[str, Any]  # (n,) all that was recorded or derived, as the card's model has them
    parameters: tuple[Parameter, ...]
    stalls: Mapping[str, Stall] = field(default_factory=dict)  # by model: card, and extended where it differs
    holdout: HoldoutScores | None = None  # None where it was not computed

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return self.card.state.outputs

    @property
    def changed(self) -> bool:
        """Whether anything was added to the card's model."""
        sensors = self.diagnosis.sensors
        return bool(self.extended.state.active or (sensors is not None and sensors.state.active))

    @property
    def seconds(self) -> float:
        """Sampling time, s."""
        return float(np.median(np.diff(self.time[self.manoeuvre == 0])))
