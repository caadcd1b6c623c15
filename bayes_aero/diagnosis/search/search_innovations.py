"""The search for missing effects in innovations: what a filter does not foresee, in air that is not at rest.

Gusts, noise of the states and of the sensors are estimated with the card's model. Their filter then follows each flight
sample by sample, and what it does not foresee is compared with every candidate of the catalogue, errors of sensors
beside aerodynamics. A gust moves vane and accelerometers together, as no error of a sensor does. In what is left
then, terms of the library are sought.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model
from bayes_aero.diagnosis.result import INNOVATIONS
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised, moved
from bayes_aero.diagnosis.search.search_result import SearchResult
from bayes_aero.diagnosis.search.search_trajectories import FIRST, noise_of, without_lags
from bayes_aero.diagnosis.selection.forward_selection import Extension, Selected, Step, selected, sized
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.diagnosis.structure.unexplained import offsets_found, withdrawn
from bayes_aero.diagnosis.terms.flown import FlownForms, flown_forms
from bayes_aero.diagnosis.terms.forms import Forms
from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.disturbed import fit_disturbed
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, PredictionErrorStatus
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.progress import Progress
from bayes_aero.residuals.filter_error import FilterError

START_STEPS = 8  # of output error, from which the filter begins: its last ones settle what the filter moves again


def search_innovations(
    records: Sequence[FlightRecord],
    card: Card,
    model: Model,
    extra: Sequence[Effect],
    settings: DiagnosisSettings,
    *,
    seed: int,
    progress: Progress | None = None,
) -> SearchResult:
    """Search in the innovations of all recorded outputs; arguments and result as of `search_trajectories`."""
    if progress:
        progress("process noise", 0.0)
    flights, outliers = despiked(join(records, card, FLIGHT))
    base = aircraft_dynamics(model, flights)
    # A start is enough. Gusts move a flight away from its simulation by less the shorter that is.
    start = np.array([p.start for p in base.free])
    brief = segments(flights, base, window=FIRST[-1], substeps=base.substeps(start, flights))
    fit = fit_output_error(brief, max_iterations=START_STEPS)
    if fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        raise InputError(f"card {card.name}: {fit.status.value}")
    full = without_lags(candidate_model(model, flights, extra, settings))
    known = full.neutral | dict(zip(fit.names, fit.estimate, strict=True))
    found, status = _searched(_Flown(full, flights, base, fit.R), known, seed, progress)
    left, failures = attempted(
        "The form of what the catalogue does not explain was not sought",
        lambda: flown_forms(found, seed=seed + 3000, progress=progress),
        FlownForms(Forms((), ()), ()),
    )
    found = withdrawn(found, left.forms.replaced, left.forms.sizes)
    notes = [
        "Of structure without a name, terms of the library are sought in innovations, and no functions of a channel or "
        "of time."
    ]
    if status is not PredictionErrorStatus.CONVERGED:
        notes.append(f"Process noise: {status.value}.")
    if still := taken_as_zero(flights):
        notes.append(f"Not recorded, and taken as zero: {', '.join(still)}.")
    noise = replace(noise_of(found, outliers), of_innovations=True)
    return SearchResult(
        found.state.full,
        ((INNOVATIONS, found),),
        (*left.unknown, *offsets_found(found, left.forms.idle)),
        noise,
        tuple(notes),
        failures,
        terms=left.forms.terms,
        forms=left.forms.rivals,
    )


class _Flown(NamedTuple):
    """What is searched: candidates, flights, the card's dynamics, and the variances of output error."""

    full: CandidateModel
    flights: Flights
    base: AircraftDynamics
    R: Float[np.ndarray, " c"]


def _searched(
    flown: _Flown,
    known: Mapping[str, float],
    seed: int,
    progress: Progress | None,
    before: Extension | None = None,
    barred: tuple[str, ...] = (),
) -> tuple[Extension, PredictionErrorStatus]:
    """One addition after the other; after each, gusts and noise are estimated anew with it in the model.

    Before, the noise of states had to stand for what was missing. `known` are parameters to start from. What is larger
    than aircraft have is `barred`, and all is sought again (see `plausible_selection`); `before` it was in.
    """
    begin = known
    active: tuple[str, ...] = ()
    apart: tuple[str, ...] = ()
    steps: tuple[Step, ...] = ()
    first: Selected | None = None
    filtered: PredictionErrorResult | None = None
    while True:
        state, filtered = _followed(flown, known, active, filtered, progress)
        state = moved(state, state.theta, apart=apart)
        room = flown.full.settings.max_effects - len(active)
        found = selected(state, seed=seed + len(active), most=min(1, room), progress=progress, barred=barred)
        first, steps = first or found, (*steps, *found.steps)
        chosen = found.state.active
        # An addition that another one has replaced ends the search: the two would replace each other for ever.
        if chosen == active or set(active) - set(chosen):
            found = found._replace(base=first.base, base_fit=first.base_fit, steps=steps)
            extension = replace(sized(found), too_large=before)
            if not extension.implausible:
                return extension, filtered.status
            return _searched(flown, begin, seed, progress, extension, (*barred, *extension.implausible))
        apart, active, known = (
            found.state.apart,
            chosen,
            dict(zip(state.full.model.names, found.state.theta, strict=True)),
        )


def _followed(
    flown: _Flown,
    known: Mapping[str, float],
    active: tuple[str, ...],
    before: PredictionErrorResult | None,
    progress: Progress | None,
) -> tuple[SelectionState, PredictionErrorResult]:
    """The filter's fit with these additions, from the one `before`, and the problem linearised there."""
    if progress:
        progress("process noise", 0.0)
    full, names = flown.full, flown.full.model.names
    out = {p.name for e in full.model.effects if e.name not in (*full.base, *active) for p in e.parameters}
    held = tuple((name, full.neutral[name]) for name in names if name in out)
    model = replace(full.model, fixed=(*full.model.fixed, *held))
    dynamics = replace(flown.base, model=model)
    start = np.array([known[name] for name in names if name not in out])
    whole = segments(flown.flights, dynamics, substeps=dynamics.substeps(start, flown.flights))
    gusty, filtered = fit_disturbed(whole, start, flown.R, exact=False, similar=before)
    if filtered.status is PredictionErrorStatus.DIVERGED:
        raise InputError(f"process noise cannot be estimated: {filtered.status.value}")
    return _state(_in_gusts(full, gusty.dynamics), gusty, filtered, flown.base, active), filtered


def _in_gusts(full: CandidateModel, dynamics: Dynamics) -> CandidateModel:
    """With the gusts of the filter. Their parameters are nobody's, so that they stay what the filter found of them."""
    assert isinstance(dynamics, AircraftDynamics)
    gusts = tuple(e for e in dynamics.model.effects if e.disturbance is not None and e not in full.model.effects)
    return replace(full, model=full.model.extended(*gusts))


def _state(
    full: CandidateModel,
    gusty: SegmentTrajectories,
    filtered: PredictionErrorResult,
    base: AircraftDynamics,
    active: tuple[str, ...],
) -> SelectionState:
    """The problem linearised at the filter's parameters, all other candidates neutral."""
    known = dict(zip(filtered.names, filtered.estimate, strict=True))
    theta = np.array([known.get(name, full.neutral[name]) for name in full.model.names])
    dynamics = replace(base, model=full.model)
    responses = FilterError.after(gusty, filtered.estimate, filtered.R, filtered.found, dynamics)
    return linearised(full, responses, responses.outputs, theta, active)
