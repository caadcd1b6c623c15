"""The search for missing effects in innovations: what a filter does not foresee, in air that is not at rest.

Gusts, noise of the states and of the sensors are estimated with the card's model. Their filter then follows each flight
sample by sample, and what it does not foresee is compared with every candidate of the catalogue, errors of sensors
beside aerodynamics. A gust moves vane and accelerometers together, as no error of a sensor does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model
from bayes_aero.diagnosis.result import INNOVATIONS
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.diagnosis.selection.forward_selection import forward_selection
from bayes_aero.diagnosis.selection.search_result import SearchResult
from bayes_aero.diagnosis.selection.search_trajectories import in_windows, noise_of, without_lags
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.disturbed import fit_disturbed
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, PredictionErrorStatus
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.progress import Progress
from bayes_aero.residuals.filter_error import FilterError


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
    fit = in_windows(flights, base)
    if fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        raise InputError(f"card {card.name}: {fit.status.value}")
    whole = segments(flights, base, substeps=base.substeps(fit.estimate, flights))
    gusty, filtered = fit_disturbed(whole, fit.estimate, fit.R, exact=False)
    if filtered.status is PredictionErrorStatus.DIVERGED:
        raise InputError(f"card {card.name}: {filtered.status.value}")
    full = _in_gusts(without_lags(candidate_model(model, flights, extra, settings)), gusty.dynamics, filtered)
    found = forward_selection(_state(full, gusty, filtered, base.altitude), seed=seed, progress=progress)
    notes = ["Structure that no effect of the catalogue describes is not sought in innovations."]
    if filtered.status is not PredictionErrorStatus.CONVERGED:
        notes.append(f"Process noise: {filtered.status.value}.")
    if still := taken_as_zero(flights):
        notes.append(f"Not recorded, and taken as zero: {', '.join(still)}.")
    return SearchResult(full, ((INNOVATIONS, found),), (), noise_of(found, outliers), tuple(notes))


def _in_gusts(full: CandidateModel, dynamics: Dynamics, filtered: PredictionErrorResult) -> CandidateModel:
    """With the gusts of the filter, held at what it found of them."""
    known, own = dict(zip(filtered.names, map(float, filtered.estimate), strict=True)), full.model
    assert isinstance(dynamics, AircraftDynamics)
    gusts = tuple(e for e in dynamics.model.effects if e.disturbance is not None and e not in own.effects)
    parameters = tuple(p for e in gusts for p in e.parameters)
    held = tuple((p.name, known[p.name]) for p in parameters)
    model = Model((*own.effects, *gusts), (*own.parameters, *parameters), (*own.fixed, *held), own.chords)
    return replace(full, model=model)


def _state(
    full: CandidateModel, gusty: SegmentTrajectories, filtered: PredictionErrorResult, altitude: bool
) -> SelectionState:
    """The problem linearised at the filter's parameters, all candidates neutral."""
    known = dict(zip(filtered.names, filtered.estimate, strict=True))
    theta = np.array([known.get(name, full.neutral[name]) for name in full.model.names])
    dynamics = AircraftDynamics(full.model, altitude)
    responses = FilterError.after(gusty, filtered.estimate, filtered.R, filtered.found, dynamics)
    return linearised(full, responses, responses.outputs, theta, ())
