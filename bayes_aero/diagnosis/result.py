"""What a diagnosis says: plain data, ready to be written and drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Consistency, Departure, HealthFinding
from bayes_aero.flight.reading import RecordReport
from bayes_aero.inference.results import COLOURED_INNOVATIONS, FrequencyFit, FrequencyResponse, OneStep, Scores, Stall
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.aircraft import Aircraft

# With what a model is compared: kinematics alone, which knows sensors and winds, or the model itself.
FLIGHT_PATH, COEFFICIENTS, TRAJECTORIES, INNOVATIONS = "flight path", "coefficients", "trajectories", "innovations"
Value = tuple[float, float]  # with its standard error, or two of a kind
LIKELY = 0.5  # probability beyond which a cause is likelier than all else together
LITTLE = 0.02  # own share of an effect below which the record hardly excites it; our choice


class Verdict(StrEnum):
    """The answer in a word."""

    NO_EFFECT = "no_effect"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"
    UNDECIDED = "undecided"  # air may be disturbed, or a parameter of a control at rest have taken up an effect
    UNRELIABLE = "unreliable"  # sensors contradict each other by more than a simulation may be off


@dataclass(frozen=True)
class Gain:
    """What a cause gains on data that were not fitted; before: with all earlier causes that are confirmed."""

    elpd: float  # sum of log predictive densities gained, divided by the variance inflation
    elpd_se: float  # its deviation from sums over 10 s
    split: str
    before: Mapping[str, Scores]  # of each coefficient: card's model
    after: Mapping[str, Scores]  # with all so far
    degraded: Mapping[str, Value] = field(default_factory=dict)  # gain of outputs predicted worse, beyond noise


class WrongChannel(NamedTuple):
    """Channels that were recorded so many times too large, as if they were in `unit` (empty: in none that is known)."""

    channels: tuple[str, ...]
    times: float
    unit: str


@dataclass(frozen=True)
class Cause:
    """One named effect."""

    name: str
    kind: str
    claim: str
    stage: str  # where it was found: the flight path (sensors), or with what the model was compared
    probability: float
    p_value: float
    ambiguous_with: tuple[str, ...]
    parameters: Mapping[str, Size]
    gain: Gain
    excited: bool = True
    # Without it the hold-out log density falls by `missed`, with its standard error, and no output is predicted worse
    # with it. A cause that is not confirmed stays out of the model that is simulated and compared.
    confirmed: bool = True
    missed: Value = (float("nan"), float("nan"))
    implausible: Mapping[str, float] = field(default_factory=dict)  # parameters beyond the largest size, with that
    own_share: float = float("nan")  # of what it does, what no other free parameter can do as well
    rival_gains: Mapping[str, Value] = field(default_factory=dict)  # hold-out log density of rivals in its place
    joint: Mapping[str, float] = field(default_factory=dict)  # correlated causes: neither size holds without the other
    wrong: WrongChannel | None = None  # where its size is that of a channel in another unit, or off by a factor
    beside_wrong: bool = False  # whether it was sought beside such a channel

    @property
    def bounded(self) -> tuple[str, ...]:
        return tuple(name for name, size in self.parameters.items() if size.at_bound)

    @property
    def likely(self) -> bool:
        """Whether it is more probable than all that could take its place, nothing included."""
        return self.probability > LIKELY

    @property
    def hardly_excited(self) -> bool:
        """Whether other free parameters reproduce nearly all of what it does."""
        return self.own_share < LITTLE

    @property
    def sure(self) -> bool:
        """Whether the verdict may rest on it: confirmed, likelier than not, and of a size that aircraft have."""
        return self.confirmed and self.likely and not (self.bounded or self.implausible or self.beside_wrong)


@dataclass(frozen=True)
class UnexplainedStructure:
    """Structure that no known effect explains: predicted on unseen data by a recorded channel or a period."""

    coefficient: str
    channel: str
    share: float  # of the remaining variance of that coefficient
    p_value: float
    rivals: tuple[str, ...] = ()  # effects that explain it about equally well, more than the record can choose among
    # By how much the coefficient's constant differs in a manoeuvre from that in the first.
    offsets: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterChange:
    """A parameter of the model that takes another value during the records; SI, standard errors count the colour."""

    parameter: str
    unit: str
    manoeuvre: str  # in which it changes
    at: float  # when, s from that manoeuvre's begin; 0: between the one before and this one
    interval: Value  # of times that the record does not tell from it at 95 %
    lasts: bool  # whether the later manoeuvres have the value after; else they have the value before
    before: Value  # value and standard error
    after: Value
    size: Value  # their difference
    share: float  # of a coefficient's remaining variance that it explains
    p_value: float
    gain: float  # log density of parts of the manoeuvres predicted from the others, over the variance inflation
    ambiguous_with: tuple[str, ...] = ()  # changes of other parameters, and effects, that explain about as much

    @property
    def between(self) -> bool:
        return self.at == 0.0


NOT_NOISE = 0.5  # share of a mean square error that noise does not make, beyond which it is more than noise


@dataclass(frozen=True)
class OutputMiss:
    """What simulated flights miss of one output, root mean squares in SI, and the `noise` of its sensor."""

    noise: float
    fitted: float  # initial states and parameters fitted to all flights
    unseen: float  # by the fit to the others from the measured initial state, whose noise is in it

    @property
    def beyond(self) -> bool:
        """Whether most of the fitted mean square error is no noise of the sensor; an error that is no number, too."""
        return not self.fitted**2 * (1.0 - NOT_NOISE) <= self.noise**2


@dataclass(frozen=True)
class Tested:
    """What a diagnosis by trajectories alone has tested; of structure without a name only terms are sought there."""

    outputs: Mapping[str, OutputMiss]  # empty where nothing was flown

    @property
    def beyond(self) -> tuple[str, ...]:
        return tuple(name for name, miss in self.outputs.items() if miss.beyond)

    @property
    def within_noise(self) -> bool:
        return bool(self.outputs) and not self.beyond


@dataclass(frozen=True)
class Diagnosis:
    """The whole finding. `sensors` and `aerodynamics` hold both elections with all scores."""

    verdict: Verdict
    causes: tuple[Cause, ...]
    minor: tuple[str, ...]
    unknown: tuple[UnexplainedStructure, ...]
    noise: NoiseReport
    not_testable: Mapping[str, str]
    sensors: Any  # `selection.Extension` of each stage, the flight path's None where it has none
    aerodynamics: Any
    split: str
    base_moves: Mapping[str, tuple[float, float, float]]  # base parameter: before, after, deviation after
    kept: tuple[str, ...] = ()  # additions to the coefficients that unseen data confirm
    notes: tuple[str, ...] = ()
    following: tuple[str, ...] = ()  # surfaces that only follow the outputs
    failures: tuple[str, ...] = ()  # parts that failed unexpectedly; what else is here is valid
    together: tuple[CancellingPair, ...] = ()  # pairs of causes of which the record knows one combination alone
    beyond: tuple[Cause, ...] = ()  # larger than on any aircraft, or estimated with such a one; out of the model
    tested: Tested | None = None  # of a diagnosis by trajectories alone
    compared: str = COEFFICIENTS  # with what the model was compared: the name of its stage
    gusts: Mapping[str, float] = field(default_factory=dict)  # m/s, of records that asked for process noise by them
    changes: tuple[ParameterChange, ...] = ()  # parameters that take another value during the records
    terms: tuple[FoundTerm, ...] = ()  # forms of the structure that no effect of the catalogue explains
    absorbed: tuple[Absorbed, ...] = ()  # parameters of controls at rest, and effects that they may have taken up
    unreliable: tuple[Departure, ...] = ()  # of sensors, by more than a simulation may be off: no effect was sought

    def judged(self, **changes: Any) -> Diagnosis:
        d = replace(self, **changes)
        verdict = verdict_of(d.causes, d.left, d.tested, d.noise, d.absorbed)
        return replace(d, verdict=Verdict.UNRELIABLE if d.unreliable else verdict)

    @property
    def by_coefficients(self) -> bool:
        """Whether the model was compared with coefficients; otherwise with trajectories alone or innovations."""
        return self.compared == COEFFICIENTS

    @property
    def left(self) -> tuple[UnexplainedStructure | ParameterChange, ...]:
        return (*self.unknown, *self.changes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.aerodynamics.state.full.model.parameters


def verdict_of(
    causes: Sequence[Cause],
    left: Sequence[UnexplainedStructure | ParameterChange],
    tested: Tested | None = None,
    noise: NoiseReport | None = None,
    absorbed: Sequence[Absorbed] = (),
) -> Verdict:
    """What is missing counts as explained by causes that are sure alone; a change of a parameter is no cause."""
    # By innovations: where they stay coloured, something is left. By trajectories alone: so it is where errors are
    # beyond the noise or were never computed; disturbed air leaves such errors, too, and it is not modelled.
    coloured = noise is not None and noise.of_innovations and bool(noise.coloured)
    if any(cause.sure for cause in causes):
        more = left or coloured or (tested is not None and not tested.within_noise)
        return Verdict.PARTLY_EXPLAINED if more else Verdict.EXPLAINED
    if left or any(cause.stage != FLIGHT_PATH for cause in causes):  # the others are the sensors'
        return Verdict.UNEXPLAINED
    # Where a parameter may have taken up an effect, its absence is not decided.
    open_ = coloured or (tested is not None and tested.beyond) or absorbed
    return Verdict.UNDECIDED if open_ else Verdict.NO_EFFECT


@dataclass(frozen=True)
class SensorCheck:
    """Flight-path consistency: the sensor errors and winds it asks for, and root mean squares before and after, SI."""

    note: str  # why it was not done; empty where it was
    errors: dict[str, dict[str, Any]]
    rms: dict[str, Value]


@dataclass(frozen=True)
class CheckReport:
    """All records together."""

    card: Card
    records: tuple[RecordReport, ...]
    uses: dict[str, str]  # of each command, why it cannot work on them; empty text: it can
    not_testable: dict[str, str]
    sensors: SensorCheck
    consistency: Consistency
    health: tuple[HealthFinding, ...] = ()  # what is wrong with the channels of the usable records
    left_out: tuple[str, ...] = ()  # a sentence on each axis of the card that the records do not serve
    failures: tuple[str, ...] = ()  # of checks that went wrong themselves

    @property
    def cautions(self) -> tuple[str, ...]:
        return tuple(finding.sentence for finding in self.health)

    @property
    def usable(self) -> bool:
        return not any(r.problems for r in self.records) and "" in self.uses.values()


@dataclass(frozen=True)
class SizeInBand:
    """A parameter of a cause, SI: in the band and of the coefficients, each with its standard error."""

    cause: str
    parameter: str
    unit: str
    in_band: Value
    coefficients: Value
    apart: float  # their difference in standard errors of the difference


@dataclass(frozen=True)
class CausesInBand:
    """Sizes of the causes in a band of frequencies."""

    band: Value  # Hz
    sizes: tuple[SizeInBand, ...]
    unseen: tuple[str, ...]  # parameters of causes that the band does not show
    converged: bool  # whether the fit did


@dataclass(frozen=True)
class FoundTerm:
    """A term of a coefficient, with its factor; SI, the standard error counts the autocorrelation of the residuals."""

    coefficient: str  # to which it adds size times the term
    term: ProductTerm
    size: Value  # estimate and standard error of its factor
    share: float  # of the variance left without it of the coefficient, or of the flown output that it explains most
    gain: float  # log density of left-out folds, divided by the variance inflation
    weight: float  # posterior probability of this term among itself and the `others`
    others: tuple[tuple[ProductTerm, float], ...]  # of about the same gain, not told from it, with the weight of each
    least: float  # smallest factor worth modelling, by what it changes over the swing of these flights


# --- Simulated trajectories: errors by flight, estimates, tests of effects, a fit by itself.

START, FITTED = "start", "fitted"
WINDOW = 12.0  # s, of the first fits


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
    model: str  # card or extended; of a fit by itself start or fitted; given, of parameters from elsewhere
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
    unseen: Value = (float("nan"), float("nan"))  # on hold-out flights; NaN where `gain` is too little
    instead: tuple[str, ...] = ()  # parameters of hysteresis that it replaces
    slight: bool = False  # too small to be named
    decisive: float = 3.0  # nats that the joint fit must gain

    @property
    def gains(self) -> bool:
        """Whether the joint fit gains enough by it that the hold-out test is worth running."""
        return self.gain > self.decisive and not self.slight


@dataclass(frozen=True)
class TrajectoryEstimates:
    """One model as fitted to all trajectories: its parameters (SI) by name, and how the fit ended."""

    values: Mapping[str, float]
    units: Mapping[str, str]
    status: Enum
    at_bound: tuple[str, ...]
    held: tuple[str, ...]  # by their priors: the trajectories say next to nothing of them


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
        return next((p for p in self.paths if (p.manoeuvre, p.model, p.split) == (manoeuvre, model, split)), None)


@dataclass(frozen=True)
class Setting:
    """How trajectories are fitted: the settings in which published programs differ."""

    outputs: tuple[str, ...] | None = None  # that are compared; None: all that are recorded and simulated but `LEFT`
    # In which every manoeuvre begins, SI, and where it names none the first sample; None: initial states are fitted.
    initial: Mapping[str, float] | None = None
    priors: bool = True  # of the reported fit, of parameters and initial states alike
    held: bool = False  # inputs between samples; else they are linear
    window: float = WINDOW
    biases: Mapping[str, Prior] = field(default_factory=dict)  # outputs recorded with a constant error, fitted, too


@dataclass(frozen=True)
class TrajectoryFit:
    """A fit to whole manoeuvres, in SI and radians."""

    fit: Any  # `OutputErrorResult`: estimates (k,), standard errors and status
    start: Float[np.ndarray, " k"]  # first values of the parameters
    paths: tuple[SimulatedManoeuvre, ...]  # of `start` (first values, measured initial state) and of `fitted`
    initial: Mapping[str, Mapping[str, Value]]  # by manoeuvre and state: at the first sample, departure from measured
    variance_inflation: float  # of the residuals; NaN if the model left the envelope
    outputs: tuple[str, ...]  # all that were recorded; those fitted are in `fit`
    units: Mapping[str, str]  # SI, by channel
    noise_growth: Mapping[str, float] = field(default_factory=dict)  # in fully separated flow, by fitted output
    setting: Setting = field(default_factory=Setting)
    frequency: tuple[FrequencyFit, ...] = ()  # of the same parameters in a band, where one was asked for
    frequency_responses: tuple[FrequencyResponse, ...] = ()  # measured and modelled there
    following: tuple[str, ...] = ()  # surfaces that only follow the outputs: with them the fit is one of many
    by_effects: bool = True  # whether the model is one of effects; else a linear system, or the flight path
    of_path: bool = False  # whether recorded accelerations and rates were flown, without a model of the aircraft
    departure_sd: Mapping[str, float] = field(default_factory=dict)  # prior deviation from the measured state, by state

    @property
    def window(self) -> float:
        return self.setting.window

    @property
    def converged(self) -> bool:
        """Whether the fit converged; a parameter may be at its bound."""
        return self.fit.status.name in ("CONVERGED", "AT_BOUND")

    @property
    def manoeuvres(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(p.manoeuvre for p in self.paths))

    def path(self, manoeuvre: str, model: str) -> SimulatedManoeuvre:
        return next(p for p in self.paths if (p.manoeuvre, p.model) == (manoeuvre, model))

    @property
    def rms_errors(self) -> dict[str, Value]:
        """Root mean square error of each output over all manoeuvres, SI: at the first values, and of the fit."""

        def rms(model: str, output: str) -> float:
            paths = [p for p in self.paths if p.model == model]
            samples = np.array([len(p.time) for p in paths])
            return float(np.sqrt(np.average(np.square([p.errors[output].rms for p in paths]), weights=samples)))

        with np.errstate(over="ignore", invalid="ignore"):  # a simulation with the first values may diverge
            return {output: (rms(START, output), rms(FITTED, output)) for output in self.outputs}

    @property
    def worse(self) -> tuple[str, ...]:
        """Outputs most of whose mean square error a fitted flight path has added to that of the record as it is."""
        # Kinematics has no other errors than those of the sensors: the fit lacks one, and others stand for it.
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
    coefficients: Value
    trajectories: Value
    apart: float


MIN_INTENSITY = 2.0  # standard errors from which an intensity is distinguishable from zero; our choice


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
    estimates: Mapping[str, Value]  # by parameter, each with its standard error
    F: Mapping[str, float]  # process noise by state, unit of the state per square root of a second
    noise_sd: Mapping[str, float]  # standard deviation of the measurement noise by output
    autocorrelation: Mapping[str, float]  # of neighbouring innovations; 0 if the disturbance is as modelled
    gusts: Mapping[str, Value] = field(default_factory=dict)  # intensity (m/s; of buffet 1) and length (m; chords)
    histories: tuple[GustHistory, ...] = ()  # what was met, by manoeuvre; of gusts that are distinguishable
    one_step: OneStep | None = None  # whether one-step predictions are calibrated; None without convergence
    covariance: Float[np.ndarray, "k k"] | None = None  # of the `estimates`, in their order

    @property
    def distinguishable(self) -> tuple[str, ...]:
        """Gusts, and buffet, of an intensity that is distinguishable from zero."""
        return tuple(name for name, (x, sd) in self.gusts.items() if x > MIN_INTENSITY * sd)

    @property
    def preferred(self) -> bool:
        return self.converged and self.gain > 0.0

    @property
    def coloured(self) -> tuple[str, ...]:
        """Outputs with neighbouring innovations that are correlated: something is not modelled."""
        return tuple(name for name, r in self.autocorrelation.items() if abs(r) > COLOURED_INNOVATIONS)


@dataclass(frozen=True)
class FlownMode:
    """A mode with its uncertainty."""

    name: str  # short period, phugoid, Dutch roll, roll, spiral; other where no name fits
    eigenvalue: complex  # 1/s; of a pair the one of positive imaginary part
    sd: Value  # standard errors of its real and imaginary part, 1/s
    # Period, time_constant, time_to_half, time_to_double (s), damping_ratio; not what the data do not tell from none.
    quantities: Mapping[str, Value]


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
    composition: Mapping[str, Mapping[str, Any]]  # scores, Theil's parts, lag 1 and calibration by coefficient
    profiles: tuple[tuple[ResidualProfile, ...], ...]  # by coefficient, the clearest dependence first
    state: Any  # the regression problem at its optimum: `selection_state.SelectionState`


@dataclass(frozen=True)
class ParameterMove:
    """A parameter of the card before and after the causes are added; standard errors count the autocorrelation."""

    before: float
    after: float
    sd_before: float
    sd_after: float
    unit: str


@dataclass(frozen=True)
class RankedCandidate:
    """One candidate of a stage's first screening, at its best value."""

    effect: str
    kind: str
    score: float
    p_value: float
    explains: float  # share of the remaining variance that it would take away, by which candidates are taken in turn
    estimate: Mapping[str, Value]  # and standard error, by parameter


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
    # By model (`card`, `extended`), data (`fitted`, `hold_out`), number of the manoeuvre, and coefficient.
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
    covariance: tuple[tuple[str, ...], Float[np.ndarray, "k k"]] | None = None  # of the extended model's estimates
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
        return self.card.state.outputs

    @property
    def changed(self) -> bool:
        sensors = self.diagnosis.sensors
        return bool(self.extended.state.active or (sensors is not None and sensors.state.active))

    @property
    def seconds(self) -> float:
        return float(np.median(np.diff(self.time[self.manoeuvre == 0])))


# --- Parts of these results: sizes, noise, ambiguities, terms, test points.


@dataclass(frozen=True)
class Size:
    """Estimate of one parameter of a cause, SI, freed of what recording noise adds; see `sizes`."""

    mean: float
    sd: float
    unit: str
    at_bound: bool = False  # the fit wants to go on beyond the parameter's bounds: this is no measurement of it

    @property
    def ci95(self) -> Value:
        return self.mean - 1.96 * self.sd, self.mean + 1.96 * self.sd


@dataclass(frozen=True)
class Confirmation:
    """What unseen data say of additions; gains of log density with their deviations."""

    kept: tuple[str, ...]  # additions that unseen data miss
    missed: Mapping[str, Value]  # what each is missed by
    harmed: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)  # outputs worse with one that is not kept


# Lag-1 correlation of means over five samples, our choice from a dozen simulated flights: white noise leaves up to a
# third through the filter, and weak colour (0.5 from sample to sample) little more.
COLOURED = 0.36


@dataclass(frozen=True)
class NoiseReport:
    """Colour, growth with separation and outliers of the residuals, by coefficient."""

    lag1: Mapping[str, float]  # of means over five samples: at the recorded rate the filter makes 0.9 of white noise
    deviation: Mapping[str, float]
    noise_growth: Mapping[str, float]  # noise at full separation over that in attached flow
    outliers: Mapping[str, int]  # repaired samples by channel
    of_innovations: bool = False  # `lag1` is then that of neighbouring samples, which white noise leaves at 0

    @property
    def coloured(self) -> tuple[str, ...]:
        """Outputs whose residuals are correlated beyond what the filters of the reconstruction make."""
        if self.of_innovations:
            return tuple(name for name, r in self.lag1.items() if abs(r) > COLOURED_INNOVATIONS)
        return tuple(name for name, r in self.lag1.items() if r > COLOURED)

    @property
    def labels(self) -> tuple[str, ...]:
        buffet, outliers = max(self.noise_growth.values()) > 1.5, sum(self.outliers.values()) > 0
        present = (("colored", self.coloured), ("buffet", buffet), ("outliers", outliers))
        return tuple(name for name, there in present if there)


@dataclass(frozen=True)
class Absorbed:
    """A `parameter` of the card's `effect` that acts through a `control` at rest, and what it may have taken up."""

    effect: str
    parameter: str
    unit: str
    control: str
    estimate: Value  # its value in the fit, with its deviation
    usual: Value  # that of its prior
    sizes: dict[str, Size]  # of each effect, were it the whole cause and the parameter as usual

    @property
    def members(self) -> frozenset[str]:
        """The effects among which the record does not decide, the card's own included."""
        return frozenset((self.effect, *self.sizes))


@dataclass(frozen=True)
class CancellingPair:
    """Two causes whose large contributions cancel: the record determines only parameters[0] + factor parameters[1]."""

    effects: tuple[str, str]
    parameters: tuple[str, str]
    factor: float
    mean: float  # of the departures from neutral, SI
    sd: float
    unit: str
    correlation: float  # of the two estimates


@dataclass(frozen=True)
class TermFactor:
    """A quantity x of which terms are products."""

    name: str
    code: str | None  # expression of signals `s`, aircraft `a`, `known` in an effect file; None where it has a state
    channels: tuple[str, ...]
    evaluate: Callable[[Mapping[str, Any], Aircraft], Float[np.ndarray, " n"]]
    lateral: bool = False  # it changes sign with the wings
    cost: int = 1  # counts as so many factors where two terms are equally good
    unit: str = "1"


@dataclass(frozen=True)
class ProductTerm:
    """A product of factors, those of several powers repeated."""

    factors: tuple[TermFactor, ...]

    @property
    def name(self) -> str:
        """The product as it is reported: `alpha^2 elevator`."""
        names = list(dict.fromkeys(f.name for f in self.factors))
        powers = [sum(f.name == name for f in self.factors) for name in names]
        return " ".join(name if k == 1 else f"{name}^{k}" for name, k in zip(names, powers, strict=True))

    @property
    def unit(self) -> str:
        """Unit of the number that the product is multiplied by, as every coefficient has none."""
        power = sum(f.unit == "rad" for f in self.factors)
        return "1" if power == 0 else "1/rad" if power == 1 else f"1/rad^{power}"

    @property
    def cost(self) -> int:
        return sum(f.cost for f in self.factors)

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(c for f in self.factors for c in f.channels))

    @property
    def code(self) -> str | None:
        """The expression in an effect file; None where a factor has a state."""
        codes = [f.code for f in self.factors]
        return None if None in codes else " * ".join(codes)  # pyright: ignore[reportArgumentType, reportCallIssue]

    def evaluate(self, signals: Mapping[str, Any], aircraft: Aircraft) -> Float[np.ndarray, " n"]:
        return np.prod([f.evaluate(signals, aircraft) for f in self.factors], axis=0)


@dataclass(frozen=True)
class TestPoint:
    """A manoeuvre to be flown."""

    __test__ = False  # no test of pytest's

    manoeuvre: str
    amplitude: float
    airspeed: float  # m/s, of the level flight in which it begins
    altitude: float  # m
    seconds: float
    excursion: Mapping[str, Value]  # least and greatest of the envelope's quantities, SI
    # By question, with this point: deviations between the closest rivals, or the probability to pass a tolerance.
    expected: tuple[float, ...]
    rate: float  # nats a second
