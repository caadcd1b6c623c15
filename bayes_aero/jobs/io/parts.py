"""The parts of JSON documents: each class is what is written; and the documents of identify and qualify."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from msgspec import UNSET, Meta, Struct, field
from msgspec import UnsetType as Unset
from msgspec.structs import fields

from bayes_aero.flight.health import Consistency, Departure, HealthFinding

Number = float | None
Size = Annotated[float, Meta(ge=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Share = Fraction | None
Pair = tuple[Number, Number]
Band = tuple[float, float]
Matrix = list[list[Number]]
Growth = dict[str, Annotated[float, Meta(ge=1)]]
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
    def of(cls, found: Any = None, **more: Any) -> Any:
        """The part with what `found` has under the names of the fields, or `more` instead; a tuple is in their order.

        Objects and tuples below become the parts that the fields name; a mapping stays as it is.
        """
        if isinstance(found, tuple):
            more = dict(zip(cls.__struct_fields__, found, strict=True))
        values = {}
        for f in _fields(cls):
            if get_origin(f.type) is Literal and len(get_args(f.type)) == 1:  # says the same in every document
                more = {f.name: get_args(f.type)[0], **more}
            value = more[f.name] if f.name in more else getattr(found, f.name, *(() if f.required else (f.default,)))
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
    # by channel, also derived ones and the rate of alpha: the flown range (0.1 and 99.9 % quantiles, SI)
    ranges: dict[str, Pair]


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
    def of(cls, found: Consistency | None = None, **_: Any) -> Any:
        """The answer, where records depart from their flight path, what explains it, what was left and permitted."""
        if found is None:
            return cls()
        return super().of(
            found,
            why_not=found.why_not or None,
            errors=found.errors or {},
            unsought=found.unsought or None,
            open={error.name: error for error in found.open},
            recorded={check.record: check for check in found.recorded},
            corrected={check.record: check for check in found.corrected},
        )


Records = Annotated[list[RecordPart], Meta(min_length=1)]
Health = Annotated[
    list[HealthFinding], Meta(description="Faults of the records' channels, as printed first; empty for sound records.")
]
Provenance = Annotated[
    dict[str, Any],
    Meta(
        description="The only part that names a time or a machine; the rest is equal for equal seed and command.",
        extra_json_schema={
            "required": ["command", "settings", "seed", "inputs", "card", "versions", "platform", "written"]
        },
    ),
]
Failures = Annotated[
    list[str],
    Meta(
        description="A sentence on each part of the run that failed unexpectedly; all other results are valid. The "
        "exit code is then 1."
    ),
]


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
    # share of the time inside the tolerance; null where the card has none
    within: Share = field(name="within_tolerance")


class ComparedOutput(PathOutput):
    """The same, beside other flights."""

    probability: Share = field(name="probability_within")


class FlownPath(Part):
    """A manoeuvre, simulated with its recorded inputs."""

    manoeuvre: str
    # start: first values of the parameters, from the measured initial state. fitted: the fit, including its initial
    # state. given: the maximum-likelihood parameters of identify, from the measured initial state.
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
    # the same, corrected for coloured residuals (Morelli and Klein 1997), in a band with the size of the residuals at
    # each frequency; contains noise_bias
    crb_corrected: Number
    # bias from noise of the recorded signals; it is subtracted from the estimate and the posterior
    noise_bias: Number | Unset = UNSET
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
    """With --next-flight: parameters of a manoeuvre scatter around the aircraft's. Manoeuvres enter by the normal
    approximation of their own fit."""

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
    # how coefficients were formed: the same filter on all signals, or as published
    coefficients: Literal["matched", "published"]
    mle: FitPart
    consistency: ConsistencyPart | Unset = UNSET
    frequency: FrequencyPart | Unset = UNSET
    posterior: IdentifiedPosterior | Unset = UNSET
    next_flight: NextFlightPart | Unset = UNSET
    stall: StallPart | Unset = UNSET
    gpr: ProcessesPart | Unset = UNSET
    # every manoeuvre, without correction by measurements. Absent if an input channel is missing (a note names it).
    simulated: list[FlownPath] | Unset = UNSET
    # only where the records were simulated: the true parameters, SI and radians
    truth: dict[str, float] | Unset = UNSET
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
    # a fitted manoeuvre flown again, a manoeuvre that was not fitted, a fitted manoeuvre on the next flight
    kind: FlightWord
    manoeuvre: str
    output: str
    tolerance: float
    probability: float  # with all that is counted
    standard_error: float  # of the Monte Carlo
    # parameters; structure: with them; gusts: with both, where gusts are counted
    chances: dict[str, Annotated[dict[Literal["value", "error"], float], TWO]] = field(name="counted")
    verdict: ToleranceWord
    within: float  # expected share of the time inside
    recorded: BesidePart | None = field(name="record")


class OutsidePart(Part):
    manoeuvre: str
    motion: Literal["recorded", "simulated"]
    channels: list[str]
    share: float  # of the samples that are farther outside than 0.1
    distance: float  # of the farthest sample, in half the flown range of each channel
    time: float  # of that sample, s from the start
    excess: dict[str, float]  # by channel, from the nearest point of the region to that sample


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
    """SI units and radians. A probability is that of a flight that stays inside the tolerance about the simulation from
    start to end."""

    schema: Literal["bayes_aero/qualification/2"]
    card: CardNames
    verdict: ToleranceWord  # of the model: it fails where one tolerance does, and passes where all do
    thresholds: Annotated[dict[Literal["passes_from", "fails_to"], float], TWO]
    draws: int  # flights drawn for every test
    tolerances: dict[str, JudgedTolerance]  # by output
    tests: list[TestPart]
    # channels of the flown region, the convex hull of all fitted samples, and those that were not recorded
    flown_region: Annotated[dict[Literal["channels", "not_recorded"], list[str]], TWO]
    outside: list[OutsidePart]
    further: FurtherPart | None
    origins: dict[str, str]  # where parameters, structure, next flight and gusts come from
    health: Health
    consistency: ConsistencyPart
    notes: list[str]
    failures: Failures
    provenance: Provenance
