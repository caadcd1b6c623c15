"""The JSON documents and their parts: each class is what is written, and the schemas are generated from them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from inspect import getsource
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from msgspec import UNSET, Meta, Struct, field
from msgspec import UnsetType as Unset
from msgspec.json import schema
from msgspec.structs import fields

from bayes_aero.diagnosis.result import CancellingPair, CausesInBand, Disagreement, SizeInBand
from bayes_aero.flight.health import Consistency, Departure, HealthFinding
from bayes_aero.inference.results import Share as InsideShare
from bayes_aero.qualification import Outside

Number = float | None
Size = Annotated[float, Meta(ge=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Share = Fraction | None
Pair = tuple[Number, Number]
Band = tuple[float, float]
Matrix = list[list[Number]]
GROWTH = "By fitted output: residual size in fully separated flow over that in attached flow; it weighs the samples."
HEALTH = "Faults of channels, as printed first; empty for sound records."
FAILURES = "A sentence on each part that failed unexpectedly; all others are valid. The exit code is then 1."
PROVENANCE = "The only part that names a time or a machine; the rest is equal for equal seed and command."
PROVENANCE_KEYS = ["command", "settings", "seed", "inputs", "card", "versions", "platform", "written"]
Growth = Annotated[dict[str, Annotated[float, Meta(ge=1)]], Meta(description=GROWTH)]
TWO, FOUR = Meta(min_length=2), Meta(min_length=4)  # keys, that is all of them
Gains = Annotated[dict[Literal["elpd", "elpd_se"], Number], TWO]
Bounded = Annotated[dict[Literal["estimate", "crb_corrected"], Number], TWO]
Scores = Annotated[dict[Literal["r", "rmse", "theil", "r2"], Number], FOUR]
CardNames = Annotated[dict[Literal["name", "title"], str], TWO]
Estimate = Annotated[dict[Literal["mean", "sd"], Number], TWO]
Quantity = Annotated[dict[Literal["value", "sd"], Number], TWO]
Coefficient = Literal["CL", "CD", "Cm", "CY", "Cl", "Cn"]
Output = Literal[
    Coefficient, "airspeed", "alpha", "theta", "beta", "phi", "psi", "p", "q", "r", "altitude", "ax", "ay", "az"
]
Stage = Literal["flight path", "coefficients", "trajectories", "innovations"]
Kind = Literal["aerodynamics", "propulsion", "mass", "measurement", "environment"]
ToleranceWord = Literal["passes", "undecided", "fails"]
FlightWord = Literal["again", "test", "next flight"]
CalibrationWord = Literal["calibrated", "too_narrow", "too_wide", "not_normal", "coloured", "undecided"]
AgreementWord = Literal["agree", "disagree_explained", "disagree_unexplained", "not_checked"]
SamplerWord = Literal["converged", "not_converged", "divergent"]


class Part(Struct, forbid_unknown_fields=True):
    """A part of a document: all of its keys. What is `UNSET` is left out."""

    @classmethod
    def of(cls, source: Any = None, /, **more: Any) -> Any:
        """The part with what `source` has under the names of the fields, or `more` instead; a tuple is in their order.
        Objects and tuples below become the parts that the fields name; a mapping stays as it is."""
        if isinstance(source, tuple):
            more = dict(zip(cls.__struct_fields__, source, strict=True))
        values = {}
        for f in _fields(cls):
            if get_origin(f.type) is Literal and len(get_args(f.type)) == 1:  # says the same in every document
                more = {f.name: get_args(f.type)[0], **more}
            value = more[f.name] if f.name in more else getattr(source, f.name, *(() if f.required else (f.default,)))
            values[f.name] = _formed(f.type, value)
        return cls(**values)


_fields: Any = cache(fields)


def _formed(kind: Any, value: Any) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if value is None or value is UNSET:
        return value
    if origin in (Annotated, Union, UnionType):
        return _formed(inner[0], value)
    if origin is dict:
        if isinstance(value, tuple):
            value = dict(zip(get_args(inner[0]), value, strict=True))
        elif not isinstance(value, Mapping):
            value = {key: getattr(value, key) for key in get_args(inner[0])}
        return {key: _formed(inner[1], x) for key, x in value.items()}
    if origin is list and isinstance(value, list | tuple):
        return [_formed(inner[0], x) for x in value]
    if isinstance(kind, type) and issubclass(kind, Part) and not isinstance(value, Part | Mapping):
        return kind.of(value)
    return value


# --- Parts of several documents.


class RecordPart(Part):
    name: str
    samples: int  # how many
    dt: float  # sampling time, s
    duration: float  # s
    ranges: dict[str, Pair]  # by channel, also derived ones: the flown range (0.1 and 99.9 % quantiles, SI)


class PathCheckPart(Part):
    rms: dict[str, Annotated[dict[Literal["left", "permitted"], Number], TWO]]  # by channel
    turbulence: Number  # included in the limit, m/s
    gusts: Number  # standard deviation that the record shows, m/s
    assumed: list[str] = field(name="assumed_zero")  # channels that were not recorded


class OpenErrorPart(Part):
    """A sensor error that the flight path does not determine (SI)."""

    unit: str
    mean: Number  # it holds, like sd, if it is the only error
    sd: Number
    among: Number  # the standard error with all others possible
    asked: bool  # fitted but not confirmed by hold-out data
    imitators: list[str]  # errors from which it is not distinguishable
    share: Number  # of its effect, that the imitators reproduce
    joint: dict[str, Number]  # errors that hold only together with it, with the correlation of the estimates


class ConsistencyPart(Part):
    """Agreement of the sensors along the flight path, in absolute terms. Empty if it was not checked."""

    agreement: AgreementWord | Unset = field(name="outcome", default=UNSET)
    why_not: str | Unset | None = UNSET
    unchecked: list[str] | Unset = UNSET  # channels of the flight path that were not recorded
    departures: list[Departure] | Unset = UNSET
    errors: dict[str, Any] | Unset = UNSET  # known errors of sensors and winds found along the flight path, by name
    unsought: str | Unset | None = UNSET  # why known errors could not be tested
    open: dict[str, OpenErrorPart] | Unset = UNSET  # by name
    recorded: dict[str, PathCheckPart] | Unset = UNSET  # by record
    corrected: dict[str, PathCheckPart] | Unset = UNSET  # the same after correction of the errors

    @classmethod
    def of(cls, consistency: Consistency | None = None, **_: Any) -> Any:
        """The answer, where records depart from their flight path, what explains it, what was left and permitted."""
        if consistency is None:
            return cls()
        return super().of(
            consistency,
            why_not=consistency.why_not or None,
            errors=consistency.errors or {},
            unsought=consistency.unsought or None,
            open={error.name: error for error in consistency.open},
            recorded={check.record: check for check in consistency.recorded},
            corrected={check.record: check for check in consistency.corrected},
        )


Records = Annotated[list[RecordPart], Meta(min_length=1)]
Health = Annotated[list[HealthFinding], Meta(description=HEALTH)]
Failures = Annotated[list[str], Meta(description=FAILURES)]
Provenance = Annotated[dict[str, Any], Meta(description=PROVENANCE, extra_json_schema={"required": PROVENANCE_KEYS})]


class MarginalPart(Part):
    """A marginal posterior with its equal-tailed 95 % interval and diagnostics."""

    mean: Number
    sd: Number
    ci95: Pair
    ess_bulk: Number
    ess_tail: Number
    rhat: Number


class SamplerPart(Part):
    """Whether a sampler's draws may be used."""

    noise: str
    status: SamplerWord
    advice: str


class MedianPart(Part):
    median: Number
    ci95: Pair


class StallPart(Part):
    """Highest lift coefficient of the steady flow (alpha-dot and rates zero) over the angles flown."""

    CL_max: MedianPart
    alpha_max: MedianPart  # its angle, rad
    at_edge: Fraction  # share of draws whose maximum is the first or last angle flown; CL_max is then a lower limit


class SettingPart(Part):
    """Settings in which published programs differ; the options of the command."""

    initial_state: Literal["free", "fixed"]  # free: fitted for each manoeuvre; fixed: the card's, or the first sample
    priors: bool  # false: the fit had no priors of parameters or initial states
    inputs: Literal["linear", "held"]  # between samples


class StatedTolerance(Part):
    value: float
    unit: str
    source: str


class PathOutput(Part):
    """An output of a simulated manoeuvre, SI."""

    unit: str
    rms: Number  # root mean square of measured minus simulated
    largest: Number
    theil: Number  # Theil's inequality coefficient
    bias: Number = field(name="theil_bias")  # share of the mean square error; so are the next two
    variance: Number = field(name="theil_variance")
    covariance: Number = field(name="theil_covariance")
    within: Share = field(name="within_tolerance")  # share of the time inside; null without a tolerance


class ComparedOutput(PathOutput):
    """The same, beside other flights."""

    probability: Share = field(name="probability_within")


class FlownPath(Part):
    """A manoeuvre, simulated with its recorded inputs."""

    manoeuvre: str
    # fitted: with its initial state; from the measured one, start: first values, given: the parameters of identify
    model: Literal["start", "fitted", "given"]
    inside: bool = field(name="inside_envelope")
    outputs: dict[str, PathOutput]


class ComparedPath(Part):
    """A manoeuvre, simulated by the card's or the extended model."""

    manoeuvre: str
    model: Literal["card", "extended"]
    split: Literal["fitted", "hold_out"]
    inside: bool = field(name="inside_envelope")
    outputs: dict[str, ComparedOutput]


class BandEstimate(Part, kw_only=True):
    estimate: float
    crb: Number  # Cramér-Rao standard error; assumes white residuals, in a band one variance at all frequencies
    # corrected for coloured residuals (Morelli and Klein 1997), in a band at each frequency; contains noise_bias
    crb_corrected: Number
    noise_bias: Number | Unset = UNSET  # from noise of the recorded signals, subtracted from estimate and posterior
    unit: str
    difference: float | Unset = UNSET  # from the time domain, in standard errors of the difference


class InseparablePart(Part):
    """Parameters that the record cannot separate: the factor by which the others widen the interval of each."""

    parameters: dict[str, Number]


class FrequencyPart(Part):
    """A fit in the frequency domain, with --frequency."""

    method: Literal["equation error", "output error"]
    band: Band  # lowest and highest frequency, Hz
    lines: int = field(name="frequencies")  # number of frequencies, of all manoeuvres together
    converged: bool
    parameters: dict[str, BandEstimate]
    unseen: list[str]  # parameters that drop out with bias and drift
    at_bound: list[str]  # parameters that went to a bound and were held there


class PointPart(Part):
    """A manoeuvre to be flown."""

    manoeuvre: str
    amplitude: float  # factor on the standard input
    airspeed: float  # of the level flight in which it begins, m/s
    altitude: float  # m
    seconds: float  # its length
    excursion: dict[str, Band]  # least and greatest value, SI


# --- results.json.


class CorrelatedPart(Part):
    pair: list[str]
    value: Number


class StartPart(Part):
    cost: Number
    outcome: str


class AloneFit(Part):
    status: Literal["converged", "at_bound", "not_converged", "singular", "stall_not_identified"]
    advice: str
    det_R: Number  # determinant of the diagonal residual covariance of CL, CD, Cm
    iterations: int
    parameters: dict[str, BandEstimate]
    fit: Annotated[dict[Coefficient, Scores], Meta(min_length=3)]
    lag1: dict[Coefficient, Number]  # autocorrelation of the residuals
    separation: Annotated[dict[Literal["minimum", "maximum"], Number], TWO]
    eigenvalues: list[Number] = field(name="information_eigenvalues")
    inseparable: list[InseparablePart]
    strong_correlations: list[CorrelatedPart]
    starts: list[StartPart]
    warnings: list[str]


class FitPart(AloneFit):
    covariance: Matrix  # of the estimates in the order of parameters, corrected for coloured residuals
    alone: dict[str, AloneFit]  # the same fit to each manoeuvre alone, by its name


class IdentifiedPosterior(Part, kw_only=True):
    """emcee and nuts under the chosen noise model; white is by emcee under white noise."""

    noise: Literal["white", "ar1", "buffet-ar1"]
    emcee: dict[str, MarginalPart] | Unset = UNSET
    nuts: dict[str, MarginalPart] | Unset = UNSET
    white: dict[str, MarginalPart] | Unset = UNSET
    status: dict[str, SamplerPart]


class ScatterPart(MarginalPart):
    over_prior: Number  # its posterior standard deviation over that of its prior


class NextParameter(Part):
    unit: str
    aircraft: MarginalPart
    scatter: ScatterPart
    next_flight: MarginalPart
    pooled: dict[str, MarginalPart]
    alone: dict[str, Bounded]  # of manoeuvres whose records determine it
    undetermined: list[str]  # manoeuvres whose records say less of it than its prior


class NextFlightPart(Part):
    """With --next-flight: manoeuvres, each by the normal approximation of its own fit, scatter around the aircraft."""

    likelihood: Literal["normal approximation"]
    manoeuvres: list[str]
    left_out: dict[str, str]  # manoeuvres without a usable fit, with the reason
    parameters: dict[str, NextParameter]
    status: SamplerWord
    advice: str


class ProcessPart(Part):
    """A Gaussian process over the test points of all folds together, and the maximum-likelihood fit there."""

    r: Number
    rmse: Number
    theil: Number
    r2: Number
    coverage50: Share
    coverage90: Share
    coverage95: Share  # share of the test points inside the central 95 % interval
    k_hat: Number  # Pareto k of the re-weighting; null where hyperparameters are at their mode
    status: str
    mle: Scores
    folds: list[Annotated[dict[Literal["gpr", "mle"], Scores], TWO]]


ByCoefficient = Annotated[dict[Coefficient, ProcessPart], Meta(min_length=3)]


class ProcessesPart(Part):
    """Gaussian processes by split and coefficient."""

    sampled_split: str
    random: ByCoefficient | Unset = UNSET
    block: ByCoefficient | Unset = UNSET
    manoeuvre: ByCoefficient | Unset = UNSET


class IdentificationDocument(Part, kw_only=True):
    """The results of one identification. A number that does not exist is null. Units are SI and radians; tau1 and tau2
    in chords travelled."""

    schema: Literal["bayes_aero/results/1"]
    card: CardNames
    records: Records
    coefficients: Literal["matched", "published"]  # the same filter on all signals, or as published
    mle: FitPart
    consistency: ConsistencyPart | Unset = UNSET
    frequency: FrequencyPart | Unset = UNSET
    posterior: IdentifiedPosterior | Unset = UNSET
    next_flight: NextFlightPart | Unset = UNSET
    stall: StallPart | Unset = UNSET
    gpr: ProcessesPart | Unset = UNSET
    simulated: list[FlownPath] | Unset = UNSET  # every manoeuvre; absent if an input is missing (a note names it)
    truth: dict[str, float] | Unset = UNSET  # only where the records were simulated: the true parameters
    verdict: list[str]
    health: Health
    notes: list[str]
    failures: Failures
    provenance: Provenance


# --- qualification.json.


class JudgedTolerance(StatedTolerance):
    verdict: ToleranceWord  # it fails where one of its tests does, and passes where all do and all records are inside


class BesidePart(Part):
    """The simulation with the estimates beside the record."""

    largest: float  # largest error
    within: float  # share of the time inside
    passed: bool


class TestPart(Part):
    kind: FlightWord  # a fitted manoeuvre again, one that was not fitted, a fitted one on the next flight
    manoeuvre: str
    output: str
    tolerance: float
    probability: float  # with all that is counted
    standard_error: float  # of the Monte Carlo
    # by parameters; structure: with them; gusts: with both
    chances: dict[str, Annotated[dict[Literal["value", "error"], float], TWO]] = field(name="counted")
    verdict: ToleranceWord
    within: float  # expected share of the time inside
    recorded: BesidePart | None = field(name="record")


class UndecidedTest(Part):
    """An undecided test: the probability to pass now, and if the parameters were known exactly."""

    kind: FlightWord
    manoeuvre: str
    output: str
    present: Fraction
    known: Fraction


class FurtherPoint(PointPart):
    expected: list[float] = field(name="probabilities")  # of each test, expected with this point and those before it
    rate: float = field(name="nats_per_second")


class FurtherPart(Part):
    """Test points that would decide undecided tests, in the order of flying; null if none is undecided."""

    tests: list[UndecidedTest]
    points: list[FurtherPoint]
    refused: dict[str, str]
    why_not: str


class QualificationDocument(Part):
    """SI units and radians. A probability is that of a flight inside the tolerance from start to end."""

    schema: Literal["bayes_aero/qualification/2"]
    card: CardNames
    verdict: ToleranceWord  # of the model: it fails where one tolerance does, and passes where all do
    thresholds: Annotated[dict[Literal["passes_from", "fails_to"], float], TWO]
    draws: int  # flights drawn for every test
    tolerances: dict[str, JudgedTolerance]  # by output
    tests: list[TestPart]
    # channels of the convex hull of all fitted samples, and those that were not recorded
    flown_region: Annotated[dict[Literal["channels", "not_recorded"], list[str]], TWO]
    outside: list[Outside]
    further: FurtherPart | None
    origins: dict[str, str]  # where parameters, structure, next flight and gusts come from
    health: Health
    consistency: ConsistencyPart
    notes: list[str]
    failures: Failures
    provenance: Provenance


# --- diagnosis.json.


class TestedOutput(Part):
    """Root mean squares of what the extended model leaves of an output, SI."""

    unit: str
    noise: Number  # of the sensor
    fitted: Number  # fitted to all flights
    unseen: Number = field(name="hold_out")  # on hold-out flights, from the measured initial state
    beyond: bool = field(name="beyond_noise")  # more than half of the fitted mean square error is not noise


class TestedPart(Part):
    """What the verdict rests on, whether unexplained structure was tested, and what trajectories alone leave."""

    rests_on: Literal["coefficients", "trajectories", "innovations"]
    unnamed_structure: bool
    within_noise: bool | None  # null if nothing was simulated
    outputs: dict[str, TestedOutput]  # by fitted output


class CauseSize(Part):
    mean: float
    sd: Number
    ci95: Pair
    unit: str
    at_bound: bool  # the parameter is at its bound: its size is not reliable; suspect another cause


ScoreKey = Literal[
    "r2_before", "r2_after", "rmse_before", "rmse_after", "r_before", "r_after", "theil_before", "theil_after"
]


class GainPart(Part):
    """Measured on hold-out data."""

    elpd: Number  # log predictive density gained over earlier confirmed causes, over the variance inflation
    elpd_se: Number
    split: Literal["manoeuvre", "block", "not measured"]
    degraded: dict[str, Gains]  # coefficients predicted worse by over 3 nats and 1.645 standard errors: not confirmed
    # before = the model on the card, after = with this and every earlier confirmed cause; both with sensors corrected
    by_coefficient: dict[Coefficient, Annotated[dict[ScoreKey, Number], Meta(min_length=8)]]


class CausePart(Part):
    name: str
    kind: Kind
    claim: str
    stage: Stage
    probability: Share  # among all its possible replacements, absence included
    p_value: Share  # family-wise over all candidates, against coloured noise; null where it entered by exchange
    excited: bool  # false if not every manoeuvre excites it
    # removing it degrades hold-out prediction significantly (one-sided, 5 %), and no coefficient is predicted worse
    # with it. Otherwise it is named, but is in neither the extended model nor the gains of later causes.
    confirmed: bool
    missed: Gains = field(name="loss_without")  # lost without it in the extended model; null if not tested
    sure: bool  # the verdict rests on it: confirmed, probability above one half, not at a bound, of a plausible size
    implausible: dict[str, float]  # parameters two standard errors beyond the largest plausible departure, with that
    own_share: Share  # of its contribution to the outputs, that no other parameter reproduces; little below 0.02
    ambiguous_with: list[str]
    # what a rival in its place has beyond it, all fitted again; one that loses over 3 nats and 1.645 deviations is none
    rival_gains: dict[str, Gains]
    joint: dict[str, float]  # causes whose estimates are correlated with its own beyond 0.9, with that correlation
    parameters: dict[str, CauseSize]
    gain: GainPart


class UnexplainedPart(Part):
    """Structure that no known effect explains."""

    coefficient: Output
    channel: str  # a recorded channel, a period in s, a term, or manoeuvre
    share: Number = field(name="share_of_variance")  # of the residual of the extended model, without the rivals
    p_value: Share
    # more than five effects that would explain it about equally well: the record cannot attribute it. From trajectories
    # and innovations, terms of other coefficients that fly about as well (COEFFICIENT over TERM).
    rivals: list[str]
    # where the constant differs between manoeuvres (channel is manoeuvre): by manoeuvre, how far it is from the first
    offsets: dict[str, Estimate]


class ChangePart(Part):
    """A parameter of the model that takes another value during the records. The extended model does not include it."""

    parameter: str
    unit: str
    manoeuvre: str  # in which it changes
    at: Size  # when, s from the begin of that manoeuvre; 0: from the manoeuvre before to this one
    interval: Band = field(name="ci95")  # times that the record does not distinguish from it
    lasts: bool  # later manoeuvres have the value after the change; otherwise the value before
    before: Estimate
    after: Estimate
    size: Estimate  # of the change
    share: Number = field(name="share_of_variance")  # of the residual of the coefficient that it explains most of
    p_value: Share  # family-wise: share of noise-only replicates in which some parameter and moment explain as much
    gain: Number = field(name="elpd")  # in log density of parts of the manoeuvres, predicted from the others
    ambiguous_with: list[str]  # parameters whose change, and effects of the catalogue that, would explain about as much


class TermPart(Part):
    """A form of unexplained structure: size times the term, beside the extended model, which does not include it."""

    coefficient: str
    term: str  # a product of factors; qhat, phat, rhat: the card's rates, CT: thrust over qbar S, X: separation point
    code: str | None  # the expression of an effect file; null where the term depends on the past
    unit: str
    size: Estimate
    share: Number = field(name="share_of_variance")  # of what is left of the coefficient, or of an output, without it
    gain: Number = field(name="elpd")  # gain in log density of left-out folds, divided by the variance inflation
    weight: Share = field(name="probability")  # among all terms of the library; each factor halves the prior one
    ambiguous_with: dict[str, float]  # terms that these records do not tell from it, with their probabilities


class UsualSize(Part):
    mean: float
    sd: Number
    unit: str


class AbsorbedPart(Part):
    """The derivative of a control that is at rest in these records. Such a derivative takes up what is constant."""

    effect: str  # of the card
    parameter: str
    unit: str
    control: str
    estimate: Estimate
    usual: Estimate  # mean and standard deviation of its prior
    # by effect: with the usual value there would be one of these, so large were it the whole cause
    sizes: Annotated[dict[str, UsualSize], Meta(min_length=1)]


class NoisePart(Part):
    """The residuals, by coefficient of the card's axes; by output where only trajectories were compared."""

    labels: list[Literal["colored", "buffet", "outliers"]]
    lag1: dict[Output, Number]
    deviation: dict[Output, Number] = field(name="sd")
    noise_growth: dict[Output, Number]  # noise at the deepest separation over that in attached flow
    outliers: dict[str, int]  # replaced samples by channel


class ScreenedPart(Part):
    """A candidate in the first screening of a stage."""

    stage: Stage
    effect: str = field(name="name")
    kind: Kind
    score: Number  # estimate over a standard error that counts the residuals' autocorrelation
    p_value: Share  # family-wise: share of noise-only replicates in which some candidate scores as high
    threshold: Number  # score that the best candidate exceeds in 1 % of noise-only replicates
    estimate: dict[str, Annotated[dict[Literal["estimate", "sd"], Number], TWO]] = field(name="parameters")
    cause: bool


class MovePart(Part):
    """A parameter of the card: fitted with the card's model alone, and with all findings."""

    before: Number
    after: Number
    sd_before: Number
    sd_after: Number
    unit: str


class CovariancePart(Part):
    """Of the extended model's estimates from their joint fit, SI, for coloured residuals; the diagonal has the squares
    of the reported standard errors, or more. Parameters found in the flight path are not in it."""

    names: list[str] = field(name="parameters")  # the rows and columns
    matrix: Matrix
    residuals: Literal["coloured"]


class CompositionPart(Part):
    """All manoeuvres fitted jointly (with noise that may grow with separation), scored at the recorded rate."""

    r: Number
    rmse: Number
    r2: Number
    theil: Number
    theil_bias: Number  # share of the mean square error; so are the next two
    theil_variance: Number
    theil_covariance: Number
    lag1: Number
    # share of residuals (5 Hz means) in the central normal band
    calibration: Annotated[dict[Literal["0.5", "0.9", "0.95"], Share], Meta(min_length=3)]


class LagPart(Part):
    """The lag test: a lag of the separation point that the coefficients leave open, added to the extended model."""

    effect: str
    gain: Number  # gain in log density of the joint fit, with variance inflation; null if it did not converge
    unseen: Gains = field(name="hold_out")  # the same on hold-out flights; null if the joint fit gains less than 3
    kept: bool  # hold-out flights confirm it, with the same test as for causes; the extended model then includes it
    instead: list[str] = field(name="instead_of")  # parameters of hysteresis that it replaces
    slight: bool  # its size is too small to be named; it is then not tested on hold-out flights


class KeptPart(Part):
    """A cause tested on hold-out flights: the loss of log density when it is removed, with variance inflation (null if
    the flight leaves its envelope without it). Not kept: the simulated model omits it."""

    elpd: Number
    elpd_se: Number
    kept: bool


class FlownEstimate(Part):
    """A parameter of both models, as fitted to the trajectories."""

    card: Number  # null where the card's model does not have it
    extended: Number
    sd: Number
    unit: str
    held_by_prior: bool
    at_bound: bool


class TrajectoriesPart(Part):
    """Simulated trajectories, SI; empty if there are none. The manoeuvres are simulated with their recorded inputs."""

    fitted: list[str] | Unset = field(name="fitted_outputs", default=UNSET)
    status: dict[str, str] | Unset = UNSET  # by model: card, extended
    at_bound: dict[str, list[str]] | Unset = UNSET  # by model: parameters whose standard errors are not reliable
    variance_inflation: float | Unset = UNSET  # variance inflation from the residuals' autocorrelation
    noise_growth: Growth | Unset = UNSET
    lag: LagPart | Unset | None = UNSET  # null if it was not tested
    causes: dict[str, KeptPart] | Unset = UNSET
    tolerances: dict[str, StatedTolerance] | Unset = UNSET
    paths: list[ComparedPath] | Unset = UNSET
    # causes held at their joint estimate when this manoeuvre is held out
    held: dict[str, list[str]] | Unset = field(name="held_without", default=UNSET)
    parameters: dict[str, FlownEstimate] | Unset = UNSET


class QuestionPart(Part):
    effects: list[str]
    enough: float  # standard errors that decide
    present: float  # those of the records alone


class DecidingPoint(PointPart):
    # for each question, by how many the rivals will differ with the records, this point and those before it
    expected: list[float] = field(name="standard_errors")
    rate: float = field(name="nats_per_second")  # expected information on all that is open


class DecidingPoints(Part):
    """Manoeuvres that decide what is open, in the order of flying; empty if nothing is or the model cannot fly."""

    questions: list[QuestionPart] | Unset = UNSET
    points: list[DecidingPoint] | Unset = UNSET
    refused: dict[str, str] | Unset = UNSET  # manoeuvres that leave the envelope, or whose input was not recorded
    envelope: dict[str, Pair] | Unset = UNSET  # least and greatest value, SI
    stated: list[str] | Unset = UNSET  # the quantities that the card's [envelope] has


class HiddenPart(Part):
    """Only if the records are simulated: the hidden effects."""

    effects: dict[str, dict[str, float]]
    named: dict[str, Literal["first", "named", "ambiguous", "minor", "missed"]]


Residuals = Annotated[
    dict[Literal["before", "after"], Annotated[dict[Coefficient, CompositionPart], Meta(min_length=3)]],
    Meta(
        description="Empty where only trajectories were compared.",
        extra_json_schema={"dependentRequired": {"before": ["after"]}},
    ),
]


class DiagnosisDocument(Part, kw_only=True):
    """The results of one diagnosis. A number that does not exist is null. Units are SI and radians; tau1 and tau2 in
    chords travelled. Standard errors count the residuals' autocorrelation."""

    schema: Literal["bayes_aero/diagnosis/5"]
    card: CardNames
    records: Records
    consistency: ConsistencyPart
    # no_effect: no significant model error is detectable. explained: sure causes, nothing else is significant.
    # partly_explained: sure causes, and structure without one, or a parameter that changes. unexplained: these without
    # a sure cause. undecided: no cause is significant, but the derivative of a control at rest may have taken up an
    # effect (see absorbed and test_points), or, from trajectories alone, errors beyond the sensors' noise remain, which
    # disturbed air leaves as well (see tested); these forbid explained. unreliable: sensors contradict each other by
    # more than the tolerances of a simulation; no effect was sought (--anyway does).
    verdict: Literal["no_effect", "explained", "partly_explained", "unexplained", "undecided", "unreliable"]
    tested: TestedPart
    sentences: list[str]  # the findings as printed
    causes: list[CausePart]  # in the order found: sensors on the flight path first, then the coefficients
    minor: list[str]  # effects too small to be named; in the extended model if hold-out data need them
    unexplained: list[UnexplainedPart]
    terms: list[TermPart]  # in the order of selection
    changes: list[ChangePart]
    cancelling: list[CancellingPair]
    absorbed: list[AbsorbedPart]
    noise: NoisePart
    not_testable: dict[str, str]  # why each of these effects could not be tested
    screening: list[ScreenedPart]
    split: Literal["manoeuvre", "block"]
    base_parameters: dict[str, MovePart]
    covariance: CovariancePart | None
    residuals: Residuals
    trajectories: TrajectoriesPart
    stall: dict[Literal["card", "extended"], StallPart]  # by model
    test_points: DecidingPoints
    in_band: CausesInBand | None  # null if there are no such causes or it was not computed
    health: Health
    notes: list[str]
    failures: Failures
    provenance: Provenance
    hidden: HiddenPart | Unset = UNSET


# --- trajectories.json.


class PriorPart(Part):
    family: Literal["normal", "lognormal", "halfnormal", "uniform"]
    location: float
    scale: float
    source: str
    default: bool  # the program's; false: the card states it


class FittedParameter(Part):
    unit: str
    start: float  # the card's value, with which the path `start` is simulated
    estimate: float
    crb: Number  # Cramér-Rao standard error of the data alone, for white residuals; null where they do not determine it
    sd_corrected: Number  # standard error with the residuals' autocorrelation (Morelli and Klein 1997) and the priors
    prior: PriorPart | None  # null where the fit had none
    held_by_prior: bool  # the records contain little information on it
    at_bound: bool
    undetermined: bool  # without priors: the records do not determine it; its value is not usable


class InitialState(Part):
    """Value at the first sample, and its departure from the measured or fixed one."""

    value: float
    departure: float
    unit: str
    prior_sd: Number  # standard deviation of the prior of the departure; null where it has none or is fixed


class PredictedPart(Part):
    """One-step predictions of all outputs together."""

    count: Annotated[int, Meta(ge=2)] = field(name="innovations")  # how many
    ratio: Pair  # root mean square over the predicted one, and its standard error; 1 if calibrated
    shares: list[InsideShare]
    # not_normal: too narrow at one level, too wide at another; coloured: neighbours are correlated beyond 0.3
    calibration: CalibrationWord = field(name="status")


class PredictedOutput(PredictedPart):
    """One-step predictions of an output."""

    rms: Size  # root mean square of measured minus predicted from the samples before, in the unit of the output


class OneStepPart(Part):
    """Whether one-step predictions are calibrated; undecided where there are too few innovations."""

    status: Literal["calibrated", "not_calibrated", "undecided"]
    outputs: dict[str, PredictedOutput]
    together: PredictedPart


class ProcessNoisePart(Part):
    """The same model with process noise, by an extended Kalman filter; standard errors for white innovations."""

    status: str
    converged: bool
    gain: Number  # log likelihood beyond that of output error, nats
    estimates: dict[str, Pair]  # by parameter: estimate and standard error
    F: dict[str, Size]  # process noise by state, unit of the state per square root of a second; 0: none
    noise_sd: dict[str, Size]  # standard deviation of the measurement noise by output
    autocorrelation: dict[str, float]  # of neighbouring innovations by output; near 0 if the disturbance is as modelled
    # intensity (m/s) and scale length (m) of gusts, and of buffet (lift coefficient of fully separated flow; chords) by
    # parameter: estimate and standard error; empty for a linear system. gusts.csv has their histories.
    gusts: dict[str, Pair]
    covariance: Matrix | None  # of the estimates, in their order
    one_step: OneStepPart | None  # null where the fit did not converge


class FlownPosterior(Part):
    """Marginals, with process noise, of parameters, of F_state, and of sigma_output (of the measurement noise)."""

    nuts: dict[str, MarginalPart]
    emcee: dict[str, MarginalPart]
    status: dict[str, SamplerPart]  # by sampler


class ModePart(Part):
    """A mode of motion; standard errors of first order in the parameters."""

    name: str  # short period, phugoid, Dutch roll, roll, spiral; other where no name fits
    eigenvalue: Band  # real and imaginary part, 1/s
    sd: Pair = field(name="eigenvalue_sd")
    period: Quantity | Unset = UNSET  # s
    damping_ratio: Quantity | Unset = UNSET
    time_constant: Quantity | Unset = UNSET  # s
    time_to_half: Quantity | Unset = UNSET  # s
    time_to_double: Quantity | Unset = UNSET  # s


class MotionPart(Part):
    """Modes of motion of the fitted model about straight level flight: only of an aircraft's model that converged."""

    airspeed: Number  # m/s; null of a linear card, and so the altitude
    altitude: Number  # m
    estimates: Literal["output error", "process noise"]  # whose modes these are
    modes: list[ModePart]
    why_not: str = field(name="why_no_modes")  # empty if there are modes


class TrajectoriesDocument(Part, kw_only=True):
    """The results of one fit to trajectories (output error). A number that does not exist is null. Units are SI and
    radians; tau1 and tau2 in chords travelled."""

    schema: Literal["bayes_aero/trajectories/5"]
    card: CardNames
    records: Records
    consistency: ConsistencyPart
    status: Literal["converged", "at_bound", "not_converged", "left_envelope"]
    converged: bool  # false: do not use the numbers; the program's exit status is 1
    sentences: list[str]  # the findings as printed
    fitted_outputs: list[str]  # that the fit compares; the altitude is reported only, unless it was asked for
    window: Annotated[float, Meta(gt=0)] = field(name="windows")  # of the windows fitted before whole manoeuvres, s
    setting: SettingPart
    iterations: Annotated[int, Meta(ge=0)]  # of the last fit
    cost: Number  # half the samples times log det R, with the priors
    det_R: Number  # determinant of the diagonal residual covariance: the cost that published programs print
    variance_inflation: Number  # from the residuals' autocorrelation, the parameters' median; it weighs the priors
    noise_growth: Growth
    parameters: dict[str, FittedParameter]
    covariance: Matrix  # of the estimates in the order of parameters, corrected for coloured residuals, priors counted
    inseparable: list[InseparablePart]
    disagreement: list[Disagreement]
    process_noise: ProcessNoisePart | Unset = UNSET
    posterior: FlownPosterior | Unset = UNSET
    frequency: list[FrequencyPart] | Unset = UNSET  # equation error and output error of a linear card
    motion: MotionPart | Unset = UNSET
    initial_states: dict[str, dict[str, InitialState]]  # by manoeuvre and state
    residual_sd: dict[str, float]  # by fitted output, over all manoeuvres; in attached flow if there is noise growth
    tolerances: dict[str, StatedTolerance]
    paths: list[FlownPath]  # every manoeuvre, simulated twice
    health: Health
    notes: list[str]
    failures: Failures
    provenance: Provenance


# --- Their schemas.

DOCUMENTS: dict[str, type[Part]] = {
    "results": IdentificationDocument,
    "diagnosis": DiagnosisDocument,
    "trajectories": TrajectoriesDocument,
    "qualification": QualificationDocument,
}


def document_schema(name: str) -> dict[str, Any]:
    """The JSON schema of a document; comments beside and above the fields are their descriptions."""
    classes = {c.__name__: c for c in (*globals().values(), SizeInBand) if isinstance(c, type)}
    parts = schema(DOCUMENTS[name])["$defs"]
    for key, part in parts.items():
        part |= {"description": " ".join((classes[key].__doc__ or "").split()), "additionalProperties": False}
        above: list[str] = []
        mro = (cls for cls in classes[key].__mro__ if cls.__module__.startswith("bayes_aero"))
        for line in (line for cls in mro for line in getsource(cls).splitlines()):
            code, _, comment = line.partition("# ")
            words = [*above, comment] if comment else above
            if declared := re.match(r"    (\w+): ", code):
                named = re.search(r'name="(\w+)"', code) or declared
                if words and named[1] in part["properties"]:
                    part["properties"][named[1]].setdefault("description", " ".join(words))
            above = words if comment and not code.strip() else []
    root = parts.pop(DOCUMENTS[name].__name__)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | root | {"$defs": parts}
