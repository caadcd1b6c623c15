"""The searches for missing effects in coefficients, in trajectories and in innovations, and what each has found."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis import selection, selection_state
from bayes_aero.diagnosis.components import has_chunks, offsets_left
from bayes_aero.diagnosis.consistency import LIGHT_TURBULENCE, check_sensors, consistency, errors_of_path, widened
from bayes_aero.diagnosis.result import FLIGHT_PATH, FoundTerm, NoiseReport, ParameterChange, UnexplainedStructure
from bayes_aero.diagnosis.screening import lag1_within, screen
from bayes_aero.diagnosis.selection import Extension
from bayes_aero.diagnosis.selection_state import CandidateModel, SelectionState
from bayes_aero.diagnosis.unexplained import Forms, Left, flown_forms, forms_of, offsets_found, unexplained, withdrawn
from bayes_aero.dynamics.flight import AircraftDynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.segments import segments
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Consistency, Departure
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import nats
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.output_error import OutputErrorResult, fit_cascade, fit_output_error
from bayes_aero.inference.prediction_error import PredictionErrorResult, PredictionErrorStatus, fit_disturbed
from bayes_aero.inference.results import OutputErrorStatus
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join, observe
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import FLIGHT, required_of
from bayes_aero.progress import Progress, quiet
from bayes_aero.residuals.base import WINDOW, FlightPathError, too_few_windows
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.residuals.output_error import FilterError, OutputError

ONLY_TERMS = "Of structure without a name, terms of the library are sought, and no functions of a channel or of time."


@dataclass(frozen=True)
class SearchResult:
    """What a search for missing effects has found, whichever way the model meets the record."""

    full: CandidateModel
    stages: Mapping[str, Extension]  # extensions by stage, the model's own last
    unknown: tuple[UnexplainedStructure, ...]
    noise: NoiseReport
    notes: tuple[str, ...]
    failures: tuple[str, ...]  # parts that failed unexpectedly
    changes: tuple[ParameterChange, ...]
    terms: tuple[FoundTerm, ...]
    forms: Mapping[str, tuple[str, float]]  # as good as a cause; see `Forms.rivals`
    unreliable: tuple[Departure, ...] = ()  # of sensors: no effect was sought

    @property
    def testable_now(self) -> bool:
        """Whether hold-out data can be tested at once; trajectories are when they are compared."""
        return not self.model.state.responses.freedom

    @property
    def model(self) -> Extension:
        return list(self.stages.values())[-1]

    @property
    def sensors(self) -> Extension | None:
        return self.stages.get(FLIGHT_PATH)

    @property
    def not_testable(self) -> Mapping[str, str]:
        """Why effects could not be tested: a lag is tested where the search has tried it and added it."""
        added = {name for extension in self.stages.values() for name in extension.state.active}
        return {name: why for name, why in self.full.not_testable.items() if name not in added}


def lacking(records: Sequence[FlightRecord], card: Card) -> tuple[str, ...]:
    """Channels that coefficients need and some record does not have: trajectories are compared then."""
    given = {*card.sums, *card.constants, *card.derived, *card.tables}
    return tuple(n for n in required_of(card.axes) if n not in given and any(not record.has(n) for record in records))


def noise_report(extension: Extension, outliers: Mapping[str, int]) -> NoiseReport:
    """Colour, size, growth and outliers of what the extended model leaves; of coefficients at the recorded rate."""
    state, names = extension.state, extension.state.outputs
    left, growth = state.left(), np.ones(len(names))
    if state.of_coefficients:
        left = state.responses.predict(state.theta)["residual"][:, : len(names)]
        blocks, growth = np.asarray(state.responses.block(left)), state.noise_growth.max(axis=0)
        lag1 = [lag1_within(x, state.responses.manoeuvre) for x in blocks.T]
    else:
        lag1 = [float(np.sum(x[1:] * x[:-1]) / np.sum(x**2)) for x in left.T]
    by_output = [lag1, [float(x.std()) for x in left.T], list(map(float, growth))]
    colour, deviation, grown = (dict(zip(names, x, strict=True)) for x in by_output)
    return NoiseReport(colour, deviation, grown, dict(outliers), state.responses.white)


@dataclass(frozen=True)
class Search:
    """The search for effects that `model` misses in records; `extra` candidates stand beside the catalogue's."""

    records: Sequence[FlightRecord]
    card: Card
    model: Model
    extra: Sequence[Effect]
    settings: selection_state.DiagnosisSettings
    seed: int
    progress: Progress = quiet
    checked: Callable[[Consistency], None] = lambda _: None  # told how sensors agree without the errors that were found

    def contradiction(self, sensors: Extension | None) -> tuple[Departure, ...]:
        """Where sensors, known errors taken out, contradict each other by more than a simulation may be off."""
        # A failure of this check is reported by `record_checks`, which compares the sensors in every job.
        if self.settings.anyway:
            return ()
        errors = None if sensors is None else errors_of_path(sensors)
        # Gusts that all air-data channels show are the filter's to estimate, however strong.
        turbulence = np.inf if sensors is None else LIGHT_TURBULENCE
        check = partial(consistency, self.records, self.card, seed=self.seed, errors=errors, turbulence=turbulence)
        report, failed = attempted("Whether sensors contradict each other was not checked", check, Consistency("error"))
        if sensors is not None and not failed:
            self.checked(report)
        return report.beyond({name: tolerance.value for name, tolerance in self.card.tolerances.items()})

    def coefficients(self) -> SearchResult:
        """Where coefficients can be formed."""
        flights, outliers = despiked(join(self.records, self.card, required_of(self.model.axes)))
        full = selection_state.candidate_model(self.model, flights, self.extra, self.settings)
        mle = fit_mle(self.model, observe(self.records, self.card, self.model), seed=self.seed)
        theta = full.vector(dict(zip(mle.names, mle.estimate, strict=True)))
        # Sensitivities take two thirds of the time without the flight path, which has its own search.
        responses = replace(EquationError.of(flights, full.model), path=())
        stages = partial(search_in_stages, full, responses, theta, seed=self.seed, progress=self.progress)
        sensors, model, denied, unreliable = stages(self.contradiction)
        seek, what = partial(unexplained, model, seed=self.seed + 2000), "Unexplained structure was not sought"
        left, failures = (Left(), ()) if unreliable else attempted(what, seek, Left())
        sought, none = partial(forms_of, model, left, seed=self.seed + 3000), Forms((), (), unknown=left.unknown)
        what = "The form of unexplained structure was not sought"
        forms, failed = (none, ()) if unreliable else attempted(what, sought, none)
        notes = []
        if filtered := selection.filtered_channels(flights):
            notes.append(
                f"The record shows no white noise of {', '.join(filtered)} (filtered before recording, or none): sizes "
                "are not corrected for the bias from such noise, and their intervals do not include it."
            )
        if not has_chunks(model.state):
            notes.append("Periodic structure was not tested: a manoeuvre is too short to be divided into blocks.")
        notes += [
            f"The flight path alone selects {name}, which can be due to gusts. This correction degrades the fit of the "
            "coefficients by more than the flight path gains, so it is not made."
            for name in denied
        ]
        extensions = sensors, withdrawn(model, (*left.replaced, *forms.replaced), forms.sizes)
        searched = self._result(full, extensions, forms, outliers, notes, (*failures, *failed), left.changes)
        return replace(searched, unreliable=unreliable)

    def _result(
        self,
        full: CandidateModel,
        extensions: Sequence[Extension | None],
        forms: Forms,
        outliers: Mapping[str, int],
        notes: Sequence[str],
        failures: Sequence[str],
        changes: tuple[ParameterChange, ...] = (),
    ) -> SearchResult:
        stages = {x.state.responses.stage: x for x in extensions if x is not None}
        model = list(stages.values())[-1]
        unknown, noise = (*forms.unknown, *offsets_found(model, forms.idle)), noise_report(model, outliers)
        about = tuple(notes), tuple(failures), changes, forms.terms, forms.rivals
        return SearchResult(full, stages, unknown, noise, *about)

    def innovations(self) -> SearchResult:
        """What a filter does not foresee: a gust moves vane and accelerometers together, as no error of a sensor."""
        self.progress("process noise", 0.0)
        unreliable = self.contradiction(None)
        flights, outliers = despiked(join(self.records, self.card, FLIGHT))
        base = aircraft_dynamics(self.model, flights)
        # A start is enough. Gusts move a flight away from its simulation by less the shorter that is.
        start = np.array([p.start for p in base.free])
        brief = segments(flights, base, window=FIRST[-1], substeps=base.substeps(start, flights))
        fit = self._inside(fit_output_error(brief, max_iterations=START_STEPS))
        full = without_lags(selection_state.candidate_model(self.model, flights, self.extra, self.settings))
        begin = full.neutral | dict(zip(fit.names, fit.estimate, strict=True))
        status, fits = PredictionErrorStatus.CONVERGED, dict[Any, Any]()  # by what is in and where they began

        def select(barred: tuple[str, ...]) -> Extension:
            """One addition after the other; after each, gusts and noise are estimated anew."""
            nonlocal status
            values, active, apart, filtered = begin, (), (), None
            steps: tuple[selection.SelectionStep, ...] = ()
            first: Extension | None = None
            while True:
                self.progress("process noise", 0.0)
                key = active, full.vector(values).tobytes()
                if key not in fits:
                    fits[key] = filtered_state(full, base, flights, fit.R, values, active, filtered)
                state, filtered = fits[key]
                state = selection_state.moved(state, state.theta, apart=apart)
                room = 0 if unreliable else min(1, self.settings.max_effects - len(active))
                seed = self.seed + len(active)
                added = selection.selected(state, seed=seed, most=room, progress=self.progress, barred=barred)
                first, steps, chosen = first or added, (*steps, *added.steps), added.state.active
                # An addition that another has replaced ends the search: the two would replace each other for ever.
                if chosen == active or set(active) - set(chosen):
                    status = filtered.status
                    return selection.sized(replace(added, base=first.base, steps=steps))
                values = dict(zip(state.full.model.names, added.state.theta, strict=True))
                apart, active = added.state.apart, chosen

        extension = selection.plausible(select)
        notes = [ONLY_TERMS]
        if status is not PredictionErrorStatus.CONVERGED:
            notes.append(f"Process noise: {status.value}.")
        return self._with_terms(extension, flights, outliers, notes, unreliable=unreliable)

    def trajectories(self) -> SearchResult:
        """In airspeed, flow angles, attitude, rates and altitude, where no accelerometer gives the coefficients."""
        # Less is seen than there: a trajectory integrates what a coefficient shows at once. A lag of the separation
        # point is tried where something is missing.
        if why := too_few_windows(self.records):
            raise InputError(why)
        flights, outliers = despiked(join(self.records, self.card, FLIGHT))
        base = aircraft_dynamics(self.model, flights)
        fit = self._inside(in_windows(flights, base))
        whole = selection_state.candidate_model(self.model, flights, self.extra, self.settings)
        state = _first_state(without_lags(whole), flights, base, dict(zip(fit.names, fit.estimate, strict=True)))
        extension = selection.plausible_selection(state, seed=self.seed, progress=self.progress)
        with np.errstate(over="raise", invalid="raise", divide="raise"):  # numbers that overflow are no answer
            with_lag = partial(_with_lag, whole, extension, flights, base, self.seed, self.progress)
            lagged, failures = attempted("Whether the separation point lags was not tested", with_lag, None)
        notes = [] if fit.status is OutputErrorStatus.CONVERGED else [f"The card's model: {fit.status.value}."]
        if absent := lacking(self.records, self.card):
            notes.append(
                f"Without {', '.join(absent)} no coefficients can be formed: the diagnosis rests on simulated "
                f"trajectories. {ONLY_TERMS}"
            )
        return self._with_terms(lagged or extension, flights, outliers, notes, failures)

    def _inside(self, fit: OutputErrorResult) -> OutputErrorResult:
        if fit.status is OutputErrorStatus.LEFT_ENVELOPE:
            raise InputError(f"card {self.card.name}: {fit.status.value}")
        return fit

    def _with_terms(
        self,
        extension: Extension,
        flights: Flights,
        outliers: Mapping[str, int],
        notes: list[str],
        failures: Sequence[str] = (),
        unreliable: tuple[Departure, ...] = (),
    ) -> SearchResult:
        """The result of a search in trajectories or innovations, with terms of the library for what is left."""
        sought, none = partial(flown_forms, extension, progress=self.progress), Forms((), ())
        what = "The form of what the catalogue does not explain was not sought"
        forms, failed = (none, ()) if unreliable else attempted(what, sought, none)
        if still := taken_as_zero(flights):
            notes.append(f"Not recorded, and taken as zero: {', '.join(still)}.")
        extension = withdrawn(extension, forms.replaced, forms.sizes)
        searched = self._result(extension.state.full, [extension], forms, outliers, notes, (*failures, *failed))
        return replace(searched, unreliable=unreliable)


# --- The two stages of a diagnosis by coefficients, and what each has to say of the other's finding.
# The flight path names errors of sensors that the coefficients would silently absorb. In gusts it may name one that is
# not there; then the coefficients, which do not wander, lose far more by the correction than the flight path gains.


def search_in_stages(
    full: CandidateModel,
    responses: EquationError,
    theta: Float[np.ndarray, " k"],
    contradiction: Callable[[Extension], tuple[Departure, ...]] = lambda _: (),
    *,
    seed: int,
    progress: Progress,
) -> tuple[Extension | None, Extension, tuple[str, ...], tuple[Departure, ...]]:
    """The flight path first, where it was recorded; the coefficients with sensors corrected; then what these deny. None
    are sought where there is a `contradiction` of the sensors."""

    def coefficients(sensors: Extension | None, most: int | None = None) -> Extension:
        progress("coefficients", 0.0)
        begin = theta
        if sensors is not None:
            off = (*sensors.state.full.base, *selection.without_hold(sensors))
            begin = sensors.state.full.at_neutral(sensors.state.theta, off)
        state = selection_state.linearised(_after(full, sensors), responses, responses.model.coefficients, begin)
        extension = selection.plausible_selection(state, seed=seed + 1000, progress=progress, most=most)
        if most is None and (left := offsets_left(extension.state, seed=seed + 1500)):
            state = selection_state.moved(state, begin, apart=(*extension.state.apart, *left))
            extension = selection.plausible_selection(state, seed=seed + 1000, progress=progress)
        return extension

    path = FlightPathError.of(responses.flights, responses.model)
    if not path.outputs:
        return None, coefficients(None), (), ()
    progress("sensors", 0.0)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(responses.linearise, theta)  # compiled while NumPy checks the sensors
        sensors = check_sensors(full, path, theta, seed=seed)
    if unreliable := contradiction(sensors):
        return sensors, coefficients(sensors, most=0), (), unreliable
    aerodynamics, denied = coefficients(sensors), list[str]()
    while (name := _denied(sensors, aerodynamics)) is not None:
        fewer = widened(sensors, selection_state.refitted(selection.removed(sensors.state, name)))
        other = coefficients(fewer)
        if selection.nats_gained(aerodynamics, other) < _path_gain(sensors, name) + full.settings.decisive:
            break
        denied, sensors, aerodynamics = [*denied, name], fewer, other
    # Errors that the coefficients named and the flight path feels: it must be judged with them, not beside them.
    felt = {block[0] for block in sensors.state.wide.blocks}
    shared = tuple(name for name in aerodynamics.state.active if name in felt)
    if sensors.state.active and shared:
        sizes = {p: aerodynamics.sizes[p] for e in shared for p in aerodynamics.state.full.parameters_of(e)}
        priors = {p: Prior("normal", x.mean, x.sd, "coefficients of the same record") for p, x in sizes.items()}
        begin = theta.copy()
        begin[full.columns(list(priors))] = [prior.normal[0] for prior in priors.values()]
        again = check_sensors(full, path, begin, seed=seed, base=shared, priors=priors)
        if len(again.state.active) < len(sensors.state.active):  # one of them had stood in for it
            other = coefficients(again)
            if selection.nats_gained(aerodynamics, other) > -full.settings.decisive:
                sensors, aerodynamics = again, other
    return sensors, aerodynamics, tuple(denied), ()


def _after(full: CandidateModel, sensors: Extension | None) -> CandidateModel:
    """What the coefficients may still add after the flight path, which is the prior of the sensors it did not elect."""
    if sensors is None:
        return replace(full, priors={})
    taken = {*sensors.state.active, *(n for larger in sensors.larger for n in selection.without_hold(larger))}
    priors, own_priors = {}, {p.name: p.prior for p in full.model.free}
    for standing in sensors.steps[-1].screening.candidate_scores if sensors.steps else ():
        for name, step, sd in zip(full.parameters_of(standing.effect), standing.step, standing.sd, strict=False):
            mean, deviation = own_priors[name].normal
            weight = deviation**-2.0 + sd**-2.0
            combined = (mean * deviation**-2.0 + step * sd**-2.0) / weight
            priors[name] = Prior("normal", combined, weight**-0.5, "flight-path kinematics of the same record")
    return replace(full, candidates=tuple(e for e in full.candidates if e.name not in taken), priors=priors)


def _denied(sensors: Extension, aerodynamics: Extension) -> str | None:
    """The sensor error whose correction costs the card's fit of the coefficients most, if it is more than it gains."""
    card = aerodynamics.base

    def deviance(without: Sequence[str]) -> float:
        """Of the coefficients under the card's effects alone, these corrections of sensors taken back."""
        state = selection_state.moved(card, card.full.at_neutral(card.theta, without))
        columns, folds = state.columns(), range(len(state.folds))
        best = selection_state.optimum(state, folds)
        return selection_state.local_fit(state, best, columns[columns < len(best)], folds)[1]

    whole = deviance(())
    losses = {e: nats(whole - deviance((e,)), card.variance_inflation) for e in sensors.state.active}
    worst = max(losses, key=lambda name: losses[name], default=None)
    return worst if worst and losses[worst] > _path_gain(sensors, worst) + card.settings.decisive else None


def _path_gain(sensors: Extension, name: str) -> float:
    """What the flight path gains by an error of a sensor, nats, its colour counted."""
    score = screen(sensors.state, without=name).of(name)
    return math.inf if score is None else nats(max(score.gain, 0.0), score.variance_inflation)


FIRST = (10.0, 5.0, 2.5)  # s, of first windows, tried until a fit converges: begun far off, long ones may stray
START_STEPS = 8  # of output error, from which the filter begins: its last ones settle what the filter moves again


def filtered_state(
    full: CandidateModel,
    base: AircraftDynamics,
    flights: Flights,
    R: Float[np.ndarray, " c"],
    values: Mapping[str, float],
    active: tuple[str, ...],
    before: PredictionErrorResult | None,
) -> tuple[SelectionState, PredictionErrorResult]:
    """The filter's fit with these additions, from the one `before`, and the problem there; `R`: of output error."""
    # All candidates are in, held at neutral until they are added: so all fits share compiled programs.
    out = {p.name for e in full.model.effects if e.name not in (*full.base, *active) for p in e.parameters}
    dynamics, start = replace(base, model=full.model), full.vector({n: x for n, x in values.items() if n not in out})
    whole = segments(flights, dynamics, substeps=dynamics.substeps(start, flights))
    gusty, filtered = fit_disturbed(whole, start, R, similar=before, held=out)
    if filtered.status is PredictionErrorStatus.DIVERGED:
        raise InputError(f"process noise cannot be estimated: {filtered.status.value}")
    # The gusts' parameters are no candidate's, so that they stay what the filter found of them.
    gusty_dynamics: Any = gusty.dynamics
    gusts = [e for e in gusty_dynamics.model.effects if e.disturbance is not None and e not in full.model.effects]
    full = replace(full, model=full.model.extended(*gusts))
    theta = full.vector(dict(zip(filtered.names, filtered.estimate, strict=True)))
    responses = FilterError.after(gusty, filtered.estimate, filtered.R, filtered.found, replace(base, model=full.model))
    return selection_state.linearised(full, responses, responses.outputs, theta, active), filtered


def in_windows(flights: Flights, dynamics: AircraftDynamics) -> OutputErrorResult:
    """The card's model fitted to windows of `WINDOW` s: the first fit that converges, or the best."""
    start = np.array([p.start for p in dynamics.free])
    finer = dynamics.substeps(start, flights)
    fits = []
    for seconds in FIRST:
        first, windows = (segments(flights, dynamics, window=w, substeps=finer) for w in (seconds, WINDOW))
        fits.append(fit_cascade([first, windows], [start]))
        if fits[-1].status is OutputErrorStatus.CONVERGED:
            return fits[-1]
    return min(fits, key=lambda fit: (fit.status is OutputErrorStatus.LEFT_ENVELOPE, fit.cost))


def _first_state(
    full: CandidateModel, flights: Flights, base: AircraftDynamics, values: Mapping[str, float], *active: str
) -> SelectionState:
    """The problem linearised where these parameters have these values and all others are neutral."""
    theta, dynamics = full.vector(values), replace(base, model=full.model)
    responses = OutputError.of(flights, dynamics, dynamics.substeps(theta, flights))
    return selection_state.linearised(full, responses, responses.outputs, theta, active)


def _with_lag(
    whole: CandidateModel,
    extension: Extension,
    flights: Flights,
    dynamics: AircraftDynamics,
    seed: int,
    progress: Progress,
) -> Extension | None:
    """What is found with a lag of the separation point in from the beginning, if that is decisively better."""
    lag, base, settings = whole.lag, extension.base, whole.settings
    if lag is None or not extension.state.active:
        return None
    progress("lag of the separation point", 0.0)
    values = dict(zip(base.full.model.names, base.theta, strict=True)) | {p.name: p.start for p in lag.parameters}
    state = selection_state.refitted(_first_state(whole, flights, dynamics, values, lag.name))
    screening = extension.steps[0].screening
    gain = nats(base.best.deviance - state.best.deviance, base.variance_inflation)
    among = len(screening.candidate_scores) + 1
    chance = selection.between_p_value(state, lag.name, among)
    if not (gain > settings.decisive and chance <= settings.block_false_alarm_rate):
        return None  # a lag that is none leaves nothing to linearise
    other = selection.plausible_selection(state, seed=seed, most=settings.max_effects - 1, progress=progress)
    if lag.name not in other.state.active or selection.nats_gained(extension, other) <= settings.decisive:
        return None
    step = selection.SelectionStep(lag.name, selection.between_p_value(other.state, lag.name, among), screening)
    return replace(other, base=base, steps=(step, *other.steps))


def without_lags(full: CandidateModel) -> CandidateModel:
    """Without effects that need a state of their own."""
    lags = [e for e in full.candidates if e.stage is Stage.LAG]
    neutral = [pair for e in lags for pair in e.neutral_values.items()]
    why = "a lag is a state of its own, tried only where something is missing; give it on the card"
    return replace(
        full,
        model=replace(full.model, fixed=(*full.model.fixed, *neutral)),
        candidates=tuple(e for e in full.candidates if e not in lags),
        not_testable={**full.not_testable, **{e.name: why for e in lags}},
    )
