"""The search for missing effects in trajectories, where no accelerometer gives the coefficients.

The card's model is flown through the recorded inputs in windows; the selection is that of the coefficients. Less is
seen than there: a trajectory integrates what a coefficient shows at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model, lag_of
from bayes_aero.diagnosis.result import TRAJECTORIES
from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.diagnosis.search.search_result import SearchResult, lacking
from bayes_aero.diagnosis.selection.forward_selection import (
    Extension,
    Progress,
    Step,
    between_p_value,
    nats_gained,
    plausible_selection,
)
from bayes_aero.diagnosis.selection.noise import NoiseReport
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.diagnosis.structure.unexplained import offsets_found, withdrawn
from bayes_aero.diagnosis.terms.flown import FlownForms, flown_forms
from bayes_aero.diagnosis.terms.forms import Forms
from bayes_aero.dynamics.flight import AircraftDynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import segments
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.output_error import fit_cascade
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.inference.variance.variance_inflation import nats
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.residuals.output_error import OutputError
from bayes_aero.residuals.windows import WINDOW, too_few_windows

FIRST = (10.0, 5.0, 2.5)  # s, of first windows, tried until a fit converges: begun far off, long ones may stray


def search_trajectories(
    records: Sequence[FlightRecord],
    card: Card,
    model: Model,
    extra: Sequence[Effect],
    settings: DiagnosisSettings,
    *,
    seed: int,
    progress: Progress | None = None,
) -> SearchResult:
    """Search in airspeed, alpha, attitude, pitch rate and altitude alone.

    Accelerations are compared too where they were recorded. A lag of the separation point that the card does not have
    would be a state of its own: it is tried where something is missing. Of structure without a name, terms of the
    library are sought.
    """
    if why := too_few_windows(records):
        raise InputError(why)
    flights, outliers = despiked(join(records, card, FLIGHT))
    base = aircraft_dynamics(model, flights)
    fit = in_windows(flights, base)
    if fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        raise InputError(f"card {card.name}: {fit.status.value}")
    whole = candidate_model(model, flights, extra, settings)
    state = _state(without_lags(whole), flights, base, dict(zip(fit.names, fit.estimate, strict=True)))
    found = plausible_selection(state, seed=seed, progress=progress)
    lagged, failures = _asked_of_a_lag(whole, found, seed, progress)
    found = lagged or found
    left, failed = attempted(
        "The form of what the catalogue does not explain was not sought",
        lambda: flown_forms(found, seed=seed + 3000, progress=progress),
        FlownForms(Forms((), ()), ()),
    )
    found = withdrawn(found, left.forms.replaced, left.forms.sizes)
    notes = [] if fit.status is OutputErrorStatus.CONVERGED else [f"The card's model: {fit.status.value}."]
    if absent := lacking(records, card):
        notes.append(
            f"Without {', '.join(absent)} no coefficients can be formed: the diagnosis rests on simulated "
            "trajectories. Of structure without a name, terms of the library are sought, and no functions of a channel "
            "or of time."
        )
    if still := taken_as_zero(flights):
        notes.append(f"Not recorded, and taken as zero: {', '.join(still)}.")
    stages = ((TRAJECTORIES, found),)
    return SearchResult(
        found.state.full,
        stages,
        (*left.unknown, *offsets_found(found, left.forms.idle)),
        noise_of(found, outliers),
        tuple(notes),
        (*failures, *failed),
        testable_now=False,
        terms=left.forms.terms,
        forms=left.forms.rivals,
    )


def in_windows(flights: Flights, dynamics: AircraftDynamics) -> OutputErrorResult:
    """The card's model fitted to windows of `WINDOW` s: the first fit that converges, or the best."""
    start = np.array([p.start for p in dynamics.free])
    finer = dynamics.substeps(start, flights)
    found = []
    for seconds in FIRST:
        first, windows = (segments(flights, dynamics, window=w, substeps=finer) for w in (seconds, WINDOW))
        found.append(fit_cascade([first, windows], [start]))
        if found[-1].status is OutputErrorStatus.CONVERGED:
            return found[-1]
    return min(found, key=lambda fit: (fit.status is OutputErrorStatus.LEFT_ENVELOPE, fit.cost))


def _state(
    full: CandidateModel,
    flights: Flights,
    base: AircraftDynamics,
    values: Mapping[str, float],
    active: tuple[str, ...] = (),
) -> SelectionState:
    """The problem linearised where these parameters have these values and all others are neutral."""
    theta = np.array([values.get(name, full.neutral[name]) for name in full.model.names])
    dynamics = replace(base, model=full.model)
    responses = OutputError.of(flights, dynamics, dynamics.substeps(theta, flights))
    return linearised(full, responses, responses.outputs, theta, active)


def _asked_of_a_lag(
    whole: CandidateModel, found: Extension, seed: int, progress: Progress | None
) -> tuple[Extension | None, tuple[str, ...]]:
    """`_with_lag`; or the sentence of a failure, which is no answer. Numbers that overflow are one."""
    what = "Whether the separation point lags was not tested"
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        return attempted(what, lambda: _with_lag(whole, found, seed, progress), None)


def _with_lag(whole: CandidateModel, found: Extension, seed: int, progress: Progress | None) -> Extension | None:
    """What is found with a lag of the separation point in from the beginning, if that is decisively better."""
    lag = lag_of(whole)
    if lag is None or not found.state.active:
        return None
    if progress:
        progress("lag of the separation point", 0.0)
    base = found.base
    values = dict(zip(base.full.model.names, base.theta, strict=True)) | {p.name: p.start for p in lag.parameters}
    responses = base.responses
    assert isinstance(responses, OutputError)
    dynamics = responses.windows.dynamics
    assert isinstance(dynamics, AircraftDynamics)
    state, fit = refitted(_state(whole, responses.flights, dynamics, values, (lag.name,)))
    among = found.steps[0].screening
    gain = nats(found.base_fit.deviance - fit.deviance, found.base.variance_inflation)
    settings, chance = state.settings, between_p_value(state, fit, lag.name, len(among.candidate_scores) + 1)
    if not (gain > settings.decisive and chance <= settings.block_false_alarm_rate):
        return None  # a lag that is none leaves nothing to linearise
    other = plausible_selection(state, seed=seed, most=settings.max_effects - 1, progress=progress)
    if lag.name not in other.state.active or nats_gained(found, other) <= settings.decisive:
        return None
    p = between_p_value(other.state, other.fit, lag.name, len(among.candidate_scores) + 1)
    return replace(other, base=base, base_fit=found.base_fit, steps=(Step(lag.name, p, among, np.nan), *other.steps))


def without_lags(full: CandidateModel) -> CandidateModel:
    """Without effects that need a state of their own."""
    lags = [e for e in full.candidates if e.stage is Stage.LAG]
    own = {name: x for e in lags for name, x in e.neutral_values.items()}
    model = replace(full.model, fixed=(*full.model.fixed, *own.items()))
    told = {
        e.name: "a lag is a state of its own, tried only where something is missing; give it on the card" for e in lags
    }
    return replace(
        full,
        model=model,
        candidates=tuple(e for e in full.candidates if e not in lags),
        not_testable={**full.not_testable, **told},
    )


def noise_of(found: Extension, outliers: Mapping[str, int]) -> NoiseReport:
    """Of the blocks that are left, by output."""
    left = found.state.left(found.fit)
    lag1 = {
        name: float(np.sum(left[1:, c] * left[:-1, c]) / np.sum(left[:, c] ** 2))
        for c, name in enumerate(found.state.outputs)
    }
    deviation = {name: float(left[:, c].std()) for c, name in enumerate(found.state.outputs)}
    return NoiseReport(lag1, deviation, dict.fromkeys(found.state.outputs, 1.0), dict(outliers))
