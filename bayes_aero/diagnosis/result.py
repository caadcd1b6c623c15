"""What a diagnosis says: plain data, ready to be written and drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.accuracy import Size
from bayes_aero.diagnosis.components import ProductTerm
from bayes_aero.diagnosis.screening import NoiseReport
from bayes_aero.diagnosis.selection import Absorbed, CancellingPair, Extension
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Consistency, HealthFinding
from bayes_aero.flight.reading import RecordReport
from bayes_aero.inference.scores import Scores
from bayes_aero.parameter import Parameter
from bayes_aero.residuals.base import COEFFICIENTS as COEFFICIENTS
from bayes_aero.residuals.base import FLIGHT_PATH as FLIGHT_PATH
from bayes_aero.residuals.base import INNOVATIONS as INNOVATIONS
from bayes_aero.residuals.base import TRAJECTORIES as TRAJECTORIES

LIKELY = 0.5  # probability beyond which a cause is likelier than all else together
LITTLE = 0.02  # own share of an effect below which the record hardly excites it; our choice


class Verdict(StrEnum):
    """The answer in a word."""

    NO_EFFECT = "no_effect"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"
    # Trajectories alone cannot tell disturbed air from a model error without a name; or a parameter of a control at
    # rest may have taken up an effect.
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Gain:
    """What a cause gains on data that were not fitted; before: with all earlier causes that are confirmed."""

    elpd: float  # sum of log predictive densities gained, divided by the variance inflation
    elpd_se: float  # its deviation from sums over 10 s
    split: str
    before: Mapping[str, Scores]  # of each coefficient: card's model
    after: Mapping[str, Scores]  # with all so far
    # Outputs that are predicted worse with it, beyond noise (see `DiagnosisSettings.degrades`), with that gain.
    degraded: Mapping[str, tuple[float, float]] = field(default_factory=dict)


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
    missed: tuple[float, float] = (float("nan"), float("nan"))
    implausible: Mapping[str, float] = field(default_factory=dict)  # parameters beyond the largest size, with that
    own_share: float = float("nan")  # of what it does, what no other free parameter can do as well
    # Hold-out log density that a rival in its place has beyond it, where that was compared.
    rival_gains: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # Causes whose estimates are correlated with its own, and that correlation: neither size holds without the other.
    joint: Mapping[str, float] = field(default_factory=dict)

    @property
    def bounded(self) -> tuple[str, ...]:
        """Parameters whose fit wants to go on beyond their bounds."""
        return tuple(name for name, size in self.parameters.items() if size.at_bound)

    @property
    def likely(self) -> bool:
        """Whether it is more probable than all that could take its place, nothing included."""
        return self.probability > LIKELY

    @property
    def sure(self) -> bool:
        """Whether the verdict may rest on it: confirmed, likelier than not, and of a size that aircraft have."""
        return self.confirmed and self.likely and not self.bounded and not self.implausible


@dataclass(frozen=True)
class UnexplainedStructure:
    """Structure that no known effect explains: predicted on unseen data by a recorded channel or a period."""

    coefficient: str
    channel: str
    share: float  # of the remaining variance of that coefficient
    p_value: float
    rivals: tuple[str, ...] = ()  # effects that explain it about equally well, more than the record can choose among
    # Where the coefficient's constant differs between manoeuvres: by how much in each from that in the first, with
    # standard errors; an effect that differs only between manoeuvres cannot be told from it.
    offsets: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterChange:
    """A parameter of the model that takes another value during the records; SI, standard errors count the colour."""

    parameter: str
    unit: str
    manoeuvre: str  # in which it changes
    at: float  # when, s from that manoeuvre's begin; 0: between the one before and this one
    interval: tuple[float, float]  # of times that the record does not tell from it at 95 %
    lasts: bool  # whether the later manoeuvres have the value after; else they have the value before
    before: tuple[float, float]  # value and standard error
    after: tuple[float, float]
    size: tuple[float, float]  # their difference
    share: float  # of a coefficient's remaining variance that it explains
    p_value: float
    gain: float  # log density of parts of the manoeuvres predicted from the others, over the variance inflation
    ambiguous_with: tuple[str, ...] = ()  # changes of other parameters, and effects, that explain about as much

    @property
    def between(self) -> bool:
        """Whether it differs from one manoeuvre to the next."""
        return self.at == 0.0


NOT_NOISE = 0.5  # share of a mean square error that noise does not make, beyond which it is more than noise


@dataclass(frozen=True)
class OutputMiss:
    """What simulated flights miss of one output, root mean squares in SI, and the `noise` of its sensor."""

    noise: float
    fitted: float  # initial states and parameters fitted to all flights
    # From the measured initial state by the fit to the others, so that the noise of that state is in it and it is no
    # measure of the model alone.
    unseen: float

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
        """Outputs that the simulation misses by more than noise."""
        return tuple(name for name, miss in self.outputs.items() if miss.beyond)

    @property
    def within_noise(self) -> bool:
        """Whether it was flown and misses nothing by more than noise."""
        return bool(self.outputs) and not self.beyond


@dataclass(frozen=True)
class Diagnosis:
    """The whole finding. `sensors` and `aerodynamics` hold both elections with all candidate_scores."""

    verdict: Verdict
    causes: tuple[Cause, ...]
    minor: tuple[str, ...]
    unknown: tuple[UnexplainedStructure, ...]
    noise: NoiseReport
    not_testable: Mapping[str, str]
    sensors: Extension | None
    aerodynamics: Extension
    theta: Float[np.ndarray, " k"]
    split: str
    base_moves: Mapping[str, tuple[float, float, float]]  # base parameter: before, after, deviation after
    kept: tuple[str, ...] = ()  # additions to the coefficients that unseen data confirm
    notes: tuple[str, ...] = ()
    following: tuple[str, ...] = ()  # surfaces that only follow the outputs
    failures: tuple[str, ...] = ()  # parts that failed unexpectedly; what else is here is valid
    together: tuple[CancellingPair, ...] = ()  # pairs of causes of which the record knows one combination alone
    # Larger than on any aircraft, and out of the model; and what was estimated together with one.
    beyond: tuple[Cause, ...] = ()
    tested: Tested | None = None  # of a diagnosis by trajectories alone
    compared: str = COEFFICIENTS  # with what the model was compared: the name of its stage
    gusts: Mapping[str, float] = field(default_factory=dict)  # m/s, of records that asked for process noise by them
    changes: tuple[ParameterChange, ...] = ()  # parameters that take another value during the records
    terms: tuple[FoundTerm, ...] = ()  # forms of the structure that no effect of the catalogue explains
    absorbed: tuple[Absorbed, ...] = ()  # parameters of controls at rest, and effects that they may have taken up

    @property
    def by_coefficients(self) -> bool:
        """Whether the model was compared with coefficients; otherwise with trajectories alone or innovations."""
        return self.compared == COEFFICIENTS

    @property
    def left(self) -> tuple[UnexplainedStructure | ParameterChange, ...]:
        """What no cause explains."""
        return (*self.unknown, *self.changes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters of the card's model and of every candidate."""
        return self.aerodynamics.state.full.model.parameters


def verdict_of(
    causes: Sequence[Cause], unknown: Sequence[UnexplainedStructure | ParameterChange], tested: Tested | None = None
) -> Verdict:
    """What is missing counts as explained by causes that are sure alone; a change of a parameter is no cause."""
    of_the_model = [cause for cause in causes if cause.stage != FLIGHT_PATH]  # the others are the sensors'
    if any(cause.sure for cause in causes):
        verdict = Verdict.PARTLY_EXPLAINED if unknown else Verdict.EXPLAINED
    else:
        verdict = Verdict.UNEXPLAINED if unknown or of_the_model else Verdict.NO_EFFECT
    return verdict if tested is None else as_tested(verdict, tested)


def as_white(verdict: Verdict, noise: NoiseReport) -> Verdict:
    """A verdict by innovations: where they stay coloured, something is left that is not explained."""
    if not (noise.of_innovations and noise.coloured):
        return verdict
    instead = {Verdict.EXPLAINED: Verdict.PARTLY_EXPLAINED, Verdict.NO_EFFECT: Verdict.UNDECIDED}
    return instead.get(verdict, verdict)


def as_absorbed(verdict: Verdict, absorbed: Sequence[Absorbed]) -> Verdict:
    """A verdict by coefficients: where a parameter may have taken up an effect, its absence is not decided."""
    return Verdict.UNDECIDED if absorbed and verdict is Verdict.NO_EFFECT else verdict


def as_tested(verdict: Verdict, tested: Tested) -> Verdict:
    """A verdict by trajectories alone: what is left beyond the noise, or was never computed, is not explained."""
    if verdict is Verdict.EXPLAINED and not tested.within_noise:
        return Verdict.PARTLY_EXPLAINED
    if verdict is Verdict.NO_EFFECT and tested.beyond:  # disturbed air leaves such errors, too, and it is not modelled
        return Verdict.UNDECIDED
    return verdict


# --- What a check of records has found, before anything is fitted.


@dataclass(frozen=True)
class SensorCheck:
    """Flight-path consistency: the sensor errors and winds it asks for, and root mean squares before and after, SI."""

    note: str  # why it was not done; empty where it was
    errors: dict[str, dict[str, Any]]
    rms: dict[str, tuple[float, float]]


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
        """What is wrong with the records, in words."""
        return tuple(finding.sentence for finding in self.health)

    @property
    def usable(self) -> bool:
        """Whether every record can be read and some command can work on all of them."""
        return not any(r.problems for r in self.records) and "" in self.uses.values()


# --- Sizes of the causes in a band of frequencies, as plain data.


@dataclass(frozen=True)
class SizeInBand:
    """A parameter of a cause, SI: in the band and of the coefficients, each with its standard error."""

    cause: str
    parameter: str
    unit: str
    in_band: tuple[float, float]
    coefficients: tuple[float, float]
    apart: float  # their difference in standard errors of the difference


@dataclass(frozen=True)
class CausesInBand:
    """Sizes of the causes in a band of frequencies."""

    band: tuple[float, float]  # Hz
    sizes: tuple[SizeInBand, ...]
    unseen: tuple[str, ...]  # parameters of causes that the band does not show
    converged: bool  # whether the fit did


# --- What is reported of a form found for structure that no effect of the catalogue explains.


@dataclass(frozen=True)
class FoundTerm:
    """A term of a coefficient, with its factor; SI, the standard error counts the autocorrelation of the residuals."""

    coefficient: str  # to which it adds size times the term
    term: ProductTerm
    size: tuple[float, float]  # estimate and standard error of its factor
    share: float  # of the variance left without it of the coefficient, or of the flown output that it explains most
    gain: float  # log density of left-out folds, divided by the variance inflation
    weight: float  # posterior probability of this term among itself and the `others`
    others: tuple[tuple[ProductTerm, float], ...]  # of about the same gain, not told from it, with the weight of each
    least: float  # smallest factor worth modelling, by what it changes over the swing of these flights
