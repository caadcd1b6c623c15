"""The search for missing effects in coefficients, in innovations and in trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model, lag_of
from bayes_aero.diagnosis.result import COEFFICIENTS, FLIGHT_PATH, INNOVATIONS, TRAJECTORIES
from bayes_aero.diagnosis.screening.accuracy import filtered_channels
from bayes_aero.diagnosis.screening.autocorrelation import NoiseReport
from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised, moved
from bayes_aero.diagnosis.search.stages import SearchResult, Stages, lacking, search_in_stages
from bayes_aero.diagnosis.selection.block_jackknife import noise_report
from bayes_aero.diagnosis.selection.forward_selection import (
    Extension,
    Selected,
    Step,
    between_p_value,
    nats_gained,
    plausible_selection,
    selected,
    sized,
)
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.diagnosis.structure.changes import has_chunks
from bayes_aero.diagnosis.structure.unexplained import Left, offsets_found, unexplained, withdrawn
from bayes_aero.diagnosis.terms.flown import FlownForms, flown_forms
from bayes_aero.diagnosis.terms.forms import Forms, described, forms_of
from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import nats
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.likelihood.output_error import fit_cascade, fit_disturbed, fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, PredictionErrorStatus
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.progress import Progress
from bayes_aero.residuals.base import WINDOW, too_few_windows
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.residuals.output_error import FilterError, OutputError


def search_coefficients(
    records: Sequence[FlightRecord],
    card: Card,
    model: Model,
    extra: Sequence[Effect],
    settings: DiagnosisSettings,
    *,
    seed: int,
    progress: Progress | None = None,
) -> SearchResult:
    """Search where coefficients can be formed; `extra` effects stand beside the catalogue's."""
    flights, outliers = despiked(join(records, card, required_of(model.axes)))
    full = candidate_model(model, flights, extra, settings)
    mle = fit_mle(model, observe(records, card, model), seed=seed)
    theta = full.neutral_vector
    for name, value in zip(mle.names, mle.estimate, strict=True):
        if name in full.model.names:
            theta[full.columns([name])[0]] = value
    both = search_in_stages(full, EquationError.of(flights, full.model), theta, seed=seed, progress=progress)
    left, failures = attempted(
        "Unexplained structure was not sought",
        lambda: unexplained(both.aerodynamics, seed=seed + 2000),
        Left((), ()),
    )
    found, failed = attempted(
        "The form of unexplained structure was not sought",
        lambda: forms_of(both.aerodynamics, left, seed=seed + 3000),
        Forms((), ()),
    )
    aerodynamics = withdrawn(both.aerodynamics, (*left.replaced, *found.replaced), found.sizes)
    named = [] if both.sensors is None else [(FLIGHT_PATH, both.sensors)]
    return SearchResult(
        full,
        (*named, (COEFFICIENTS, aerodynamics)),
        (*described(left.unknown, found), *offsets_found(aerodynamics, found.idle)),
        noise_report(aerodynamics, outliers),
        (*_filtered(flights), *_too_short(aerodynamics.state), *_denials(both)),
        (*failures, *failed),
        changes=left.changes,
        terms=found.terms,
        forms=found.rivals,
    )


def _filtered(flights: Flights) -> tuple[str, ...]:
    """What the user should know of the intervals."""
    filtered = filtered_channels(flights)
    if not filtered:
        return ()
    return (
        f"The record shows no white noise of {', '.join(filtered)} (filtered before recording, or none): sizes are not "
        "corrected for the bias from such noise, and their intervals do not include it.",
    )


def _too_short(state: SelectionState) -> tuple[str, ...]:
    """That periods were not tested, if a manoeuvre is too short for them."""
    if has_chunks(state):
        return ()
    return ("Periodic structure was not tested: a manoeuvre is too short to be divided into blocks.",)


def _denials(found: Stages) -> tuple[str, ...]:
    """A sentence on each sensor error that the flight path selects and the coefficients reject."""
    return tuple(
        f"The flight path alone selects {name}, which can be due to gusts. This correction degrades the fit of the "
        "coefficients by more than the flight path gains, so it is not made."
        for name in found.denied
    )


# --- The search for missing effects in innovations: what a filter does not foresee, in air that is not at rest.
# Gusts, noise of the states and of the sensors are estimated with the card's model. Their filter then follows each
# flight sample by sample, and what it does not foresee is compared with every candidate of the catalogue, errors of
# sensors beside aerodynamics. A gust moves vane and accelerometers together, as no error of a sensor does. In what
# is left then, terms of the library are sought.

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


# --- The search for missing effects in trajectories, where no accelerometer gives the coefficients.
# The card's model is flown through the recorded inputs in windows; the selection is that of the coefficients. Less
# is seen than there: a trajectory integrates what a coefficient shows at once.

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
    state = _first_state(without_lags(whole), flights, base, dict(zip(fit.names, fit.estimate, strict=True)))
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


def _first_state(
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
    state, fit = refitted(_first_state(whole, responses.flights, dynamics, values, (lag.name,)))
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
