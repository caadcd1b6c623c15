"""The two stages of a diagnosis, flight path and coefficients, and what each has to say of the other's finding.

The flight path names errors of sensors that the coefficients would silently absorb. In gusts it may name one that is
not there; then the coefficients, which do not wander, lose far more by the correction than the flight path gains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.consistency import check_sensors
from bayes_aero.diagnosis.result import FoundTerm, ParameterChange, UnexplainedStructure
from bayes_aero.diagnosis.screening.autocorrelation import NoiseReport
from bayes_aero.diagnosis.screening.parameter_fit import local_fit, optimum, refitted
from bayes_aero.diagnosis.screening.screening import screen
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised, moved
from bayes_aero.diagnosis.selection.block_jackknife import widened
from bayes_aero.diagnosis.selection.forward_selection import Extension, nats_gained, plausible_selection, removed
from bayes_aero.diagnosis.selection.gains import without_hold
from bayes_aero.diagnosis.structure.changes import offsets_left
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import nats
from bayes_aero.parameter import Prior
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.progress import Progress
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.residuals.flight_path import FlightPathError


@dataclass(frozen=True)
class Stages:
    """Both elections; `sensors` is None without a flight path, `denied` what it named and the coefficients deny."""

    sensors: Extension | None
    aerodynamics: Extension
    denied: tuple[str, ...] = ()


def search_in_stages(
    full: CandidateModel,
    responses: EquationError,
    theta: Float[np.ndarray, " k"],
    *,
    seed: int,
    progress: Progress | None = None,
) -> Stages:
    """The flight path first, where it was recorded; the coefficients with sensors corrected; then what these deny."""

    def coefficients(sensors: Extension | None) -> Extension:
        if progress:
            progress("coefficients", 0.0)
        begin = theta
        if sensors is not None:
            begin = sensors.state.full.at_neutral(
                sensors.state.theta, (*sensors.state.full.base, *without_hold(sensors))
            )
        state = linearised(_after(full, sensors), responses, responses.model.coefficients, begin)
        found = plausible_selection(state, seed=seed + 1000, progress=progress)
        if left := offsets_left(found.state, seed=seed + 1500):
            state = moved(state, begin, apart=(*found.state.apart, *left))
            found = plausible_selection(state, seed=seed + 1000, progress=progress)
        return found

    path = FlightPathError.of(responses.flights, responses.model)
    if not path.outputs:
        return Stages(None, coefficients(None))
    if progress:
        progress("sensors", 0.0)
    sensors = check_sensors(full, path, theta, seed=seed)
    aerodynamics, denied = coefficients(sensors), []
    while (name := _denied(sensors, aerodynamics)) is not None:
        state, fit = refitted(removed(sensors.state, name))
        fewer = widened(sensors, state, fit)
        other = coefficients(fewer)
        if nats_gained(aerodynamics, other) < _path_gain(sensors, name) + full.settings.decisive:
            break
        denied, sensors, aerodynamics = [*denied, name], fewer, other
    if sensors.state.active and (known := _shared(sensors, aerodynamics)):
        told = _told(aerodynamics, known)
        again = check_sensors(full, path, _with(theta, full, told), seed=seed, known=known, priors=told)
        if len(again.state.active) < len(sensors.state.active):  # one of them had stood in for it
            other = coefficients(again)
            if nats_gained(aerodynamics, other) > -full.settings.decisive:
                sensors, aerodynamics = again, other
    return Stages(sensors, aerodynamics, tuple(denied))


def _shared(sensors: Extension, aerodynamics: Extension) -> tuple[str, ...]:
    """Errors that the coefficients named and the flight path feels: it must be judged with them, not beside them."""
    felt = {block[0] for block in sensors.state.blocks}
    return tuple(name for name in aerodynamics.state.active if name in felt)


def _told(aerodynamics: Extension, known: Sequence[str]) -> dict[str, Prior]:
    """What the coefficients say of these."""
    names = [p for effect in known for p in aerodynamics.state.full.parameters_of(effect)]
    found = {name: aerodynamics.sizes[name] for name in names}
    return {
        name: Prior("normal", size.mean, size.sd, "coefficients of the same record") for name, size in found.items()
    }


def _with(theta: Float[np.ndarray, " k"], full: CandidateModel, told: Mapping[str, Prior]) -> Float[np.ndarray, " k"]:
    moved = theta.copy()
    moved[full.columns(list(told))] = [prior.normal[0] for prior in told.values()]
    return moved


def _after(full: CandidateModel, sensors: Extension | None) -> CandidateModel:
    """What the coefficients may still add, once the flight path has named its sensors."""
    taken = set[str]()
    if sensors is not None:
        taken = {*sensors.state.active, *(n for larger in sensors.larger for n in without_hold(larger))}
    candidates = tuple(e for e in full.candidates if e.name not in taken)
    return replace(full, candidates=candidates, priors=_kinematic_priors(full, sensors))


def _kinematic_priors(full: CandidateModel, sensors: Extension | None) -> dict[str, Prior]:
    """What the flight path says of sensor errors that it did not elect: the coefficients must not contradict it."""
    if sensors is None or not sensors.steps:
        return {}
    priors = {}
    own = {p.name: p.prior for p in full.model.free}
    for standing in sensors.steps[-1].screening.candidate_scores:
        for name, step, sd in zip(full.parameters_of(standing.effect), standing.step, standing.sd, strict=False):
            mean, deviation = own[name].normal
            weight = deviation**-2.0 + sd**-2.0
            combined = (mean * deviation**-2.0 + step * sd**-2.0) / weight
            priors[name] = Prior("normal", combined, weight**-0.5, "flight-path kinematics of the same record")
    return priors


def _denied(sensors: Extension, aerodynamics: Extension) -> str | None:
    """The sensor error whose correction costs the card's fit of the coefficients most, if it is more than it gains."""
    card = aerodynamics.base
    whole = _deviance(card, ())
    losses = {e: nats(whole - _deviance(card, (e,)), card.variance_inflation) for e in sensors.state.active}
    worst = max(losses, key=lambda name: losses[name], default=None)
    return worst if worst and losses[worst] > _path_gain(sensors, worst) + card.settings.decisive else None


def _path_gain(sensors: Extension, name: str) -> float:
    """What the flight path gains by an error of a sensor, nats, its colour counted."""
    own = screen(sensors.state, sensors.fit, seed=0, nulls=False, without=name).of(name)
    return math.inf if own is None else nats(max(own.gain, 0.0), own.variance_inflation)


def _deviance(card: SelectionState, without: Sequence[str]) -> float:
    """Of the coefficients under the card's effects alone, these corrections of sensors taken back."""
    state = moved(card, card.full.at_neutral(card.theta, without))
    columns = state.columns()
    best, folds = optimum(state, range(len(state.folds))), range(len(state.folds))
    return local_fit(state, best, columns[columns < len(best)], folds)[1]


# --- What a search for missing effects has found, whichever way the model meets the record.


@dataclass(frozen=True)
class SearchResult:
    """Extensions by stage, the model's own last; structure without a name; noise.

    `testable_now`: whether hold-out data can be asked at once; trajectories ask them when they are compared.
    """

    full: CandidateModel
    stages: tuple[tuple[str, Extension], ...]
    unknown: tuple[UnexplainedStructure, ...]
    noise: NoiseReport
    notes: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()  # parts that failed unexpectedly
    testable_now: bool = True
    changes: tuple[ParameterChange, ...] = ()
    terms: tuple[FoundTerm, ...] = ()
    forms: Mapping[str, tuple[str, float]] = field(default_factory=dict)  # as good as a cause; see `Forms.rivals`

    @property
    def model(self) -> Extension:
        """The extension of the model itself."""
        return self.stages[-1][1]

    @property
    def sensors(self) -> Extension | None:
        """The extension of the flight path, by errors of sensors."""
        return self.stages[0][1] if len(self.stages) > 1 else None

    @property
    def not_testable(self) -> Mapping[str, str]:
        """Why effects could not be tested: a lag is tested where the search has tried it and added it."""
        added = {name for _, one in self.stages for name in one.state.active}
        return {name: why for name, why in self.full.not_testable.items() if name not in added}

    @property
    def by_stage(self) -> Mapping[str, Extension]:
        """The extensions by name of the stage."""
        return dict(self.stages)


def lacking(records: Sequence[FlightRecord], card: Card) -> tuple[str, ...]:
    """Channels that coefficients need and some record does not have: trajectories are compared then."""
    given = {*card.sums, *card.constants, *card.derived, *card.tables}
    return tuple(n for n in required_of(card.axes) if n not in given and any(not record.has(n) for record in records))
