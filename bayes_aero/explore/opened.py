"""A finished result with its records: what the page shows, and its manoeuvres flown again by one compiled function."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.dynamics.flight import DERIVED, Dynamics, aircraft_dynamics, biased_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, segments, simulate
from bayes_aero.effect import Effect, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.export.identified import Identified
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.check import RecordChecks, record_checks
from bayes_aero.jobs.finished import FinishedResult, IdentifiedLinear, as_written, drawn, read_finished, write_export
from bayes_aero.jobs.options import FIXED, HELD
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join
from bayes_aero.model.records import on_recorded_axes
from bayes_aero.parameter import Parameter
from bayes_aero.physics.aircraft import FLIGHT, OF_AXIS
from bayes_aero.processes import Compiled, compiled_at
from bayes_aero.report.pages.parts import consistency_sentences
from bayes_aero.report.phrases import for_people, plain_unit
from bayes_aero.residuals.equation_error import EquationError

ERRORS = 5.0  # standard errors to either side
SHARE = 0.3  # of the value, at least: a parameter known to 0.1 % still moves something to see
LIMITS = (
    "The card states a linear system: it has no effects to switch or to add, no coefficients, and no form in another "
    "simulator."
)


@dataclass(frozen=True)
class OpenedResult(FinishedResult):
    """A result with its flights. SI and radians."""

    flown: Sequence[FlightRecord]
    errors: Mapping[str, float]  # standard errors by parameter, where the result has them
    departures: Mapping[str, Mapping[str, float]]
    """By manoeuvre and state, what was fitted to its measured value at the first sample; empty: the initial states are
    the measured ones."""
    checks: RecordChecks

    @property
    def doubts(self) -> tuple[str, ...]:
        """What makes the records doubtful, a sentence each; empty for sound ones."""
        answer = consistency_sentences(self.checks.consistency, corrects=False)
        disagree = answer[:1] if self.checks.consistency.disagrees else []
        return (*self.checks.failures, *(f"{f.sentence}." for f in self.checks.health if f.grave), *disagree)

    @property
    def title(self) -> str:
        return f"{self.command}: {self.folder}"

    @property
    def limits(self) -> tuple[str, ...]:
        """Doubts about the records, and a sentence on each thing that the model or the fit has and the page has not."""
        sentences = [*self.doubts, *([LIMITS] if self.linear is not None else [])]
        if self.command == "fly" and self.filtered:
            sentences.append(
                "The values are those of the fit with process noise. Its gusts and the noise of its states "
                "are not flown here, as the result has no history of that noise: errors are those in still air."
            )
        return tuple(sentences)

    def groups(self, added: tuple[str, ...] = ()) -> tuple[SliderGroup, ...]:
        identified = self.identified
        if isinstance(identified, IdentifiedLinear):
            return linear_groups(identified, self.errors)
        return groups_of(identified.model, identified.values, self.errors, added)

    def addable(self, channels: Sequence[str]) -> tuple[Effect, ...]:
        identified = self.identified
        return () if isinstance(identified, IdentifiedLinear) else addable(identified.model, channels)


def open_result(given: str, card: str | None = None, folders: Sequence[Path] = ()) -> OpenedResult:
    """Read the result in a folder or file, its card and its records, which may lie in `folders`."""
    result = read_finished(given, card)
    records = result.records("give its folder with --records", folders=folders)
    document, departures = result.told, {}
    with as_written(result.file):
        if result.command == "identify":
            sds = {name: p["crb_corrected"] for name, p in document["mle"]["parameters"].items()}
        elif result.command == "fly":
            sds = {name: p["sd_corrected"] for name, p in document["parameters"].items()}
            if result.filtered:  # whose fit has no initial states
                sds |= {name: sd for name, (_, sd) in document["process_noise"]["estimates"].items()}
            else:
                for manoeuvre, states in document["initial_states"].items():
                    departures[manoeuvre] = {name: float(state["departure"]) for name, state in states.items()}
        else:
            sds = {name: move["sd_after"] for name, move in document["base_parameters"].items()}
            sds |= {name: p["sd"] for cause in document["causes"] for name, p in cause["parameters"].items()}
    errors = {name: float(x) for name, x in sds.items() if x is not None and x > 0.0}
    checks = record_checks(records, result.card, 0, seek=False)
    return OpenedResult(**vars(result), flown=records, errors=errors, departures=departures, checks=checks)


# --- What is chosen on the page: values, effects that are off, effects that are added, and the model of it.


@dataclass(frozen=True)
class Choice:
    """Values (SI) of parameters that differ from the result's, names of effects that are `off` and that are `added`."""

    values: Mapping[str, float] = field(default_factory=dict)
    off: frozenset[str] = frozenset()
    added: tuple[str, ...] = ()


def shown_effects(model: Model, added: Sequence[str] = ()) -> tuple[Effect, ...]:
    """Effects that can be switched off: with parameters that a simulation without noise follows, not at neutral."""
    return tuple(e for e in with_added(model, added).acting if e.parameters and e.disturbance is None)


def addable(model: Model, channels: Sequence[str]) -> tuple[Effect, ...]:
    """Effects of the catalogue that may be added: candidates on the model's axes whose channels were recorded."""
    acting = {e.name for e in model.acting}
    names = {p.name for p in model.parameters}
    have = {*channels, "alpha_dot", "X", "dt", "start", "elapsed", "first", "last"}
    return tuple(
        e
        for e in CATALOGUE.values()
        if e.candidate
        and e.name not in acting
        and e.disturbance is None
        and e.acts_on(model.axes)
        and have.issuperset(e.channels)
        and names.issuperset(e.uses)
        and (e.name in {x.name for x in model.effects} or names.isdisjoint(p.name for p in e.parameters))
    )


def flown_model(model: Model, choice: Choice) -> Model:
    """The model that is flown: every parameter of the effects that act is free, and nothing else is there. A lag that
    is off is left out: its separation point would be a state with the least lag. So are random processes, which a
    simulation without noise does not follow, and effects that the card fixes at neutral."""
    wider = with_added(model, choice.added)
    neutral = {p.name: p.neutral for e in wider.effects for p in e.parameters}
    gone = {e.name for e in wider.acting if e.stage is Stage.LAG and e.name in choice.off}
    kept = tuple(e for e in wider.acting if e.name not in gone and e.disturbance is None)
    names = {p.name for e in kept for p in e.parameters}
    held = {name: dict(wider.fixed).get(name, x) for name, x in neutral.items() if name not in names}
    parameters = tuple(p for p in wider.parameters if p.name in names)
    return replace(wider, effects=kept, parameters=parameters, fixed=tuple(held.items()))


def values_of(model: Model, values: Mapping[str, float], choice: Choice) -> dict[str, float]:
    """Of a `flown_model`, SI: chosen values, else the result's `values`, else where a fit begins; neutral where off."""
    theta = {p.name: values.get(p.name, p.start) for p in model.parameters}
    theta |= {p.name: p.start for e in model.effects if e.name in choice.added for p in e.parameters}
    theta |= {name: x for name, x in choice.values.items() if name in theta}
    return theta | {p.name: p.neutral for e in model.effects if e.name in choice.off for p in e.parameters}


def with_added(model: Model, added: Sequence[str]) -> Model:
    """The model with the `added` effects, their parameters free: a card may hold an effect at neutral."""
    there = {e.name for e in model.effects}
    freed = {p.name for e in model.effects if e.name in added for p in e.parameters}
    fixed = tuple((name, x) for name, x in model.fixed if name not in freed)
    return replace(model, fixed=fixed).extended(*(name for name in added if name not in there))


def chosen_model(opened: OpenedResult, choice: Choice, values: Mapping[str, float]) -> Identified:
    """The model with the added effects at `values` (SI) of what is flown; what is off is fixed at neutral."""
    identified = opened.identified
    if isinstance(identified, IdentifiedLinear):
        raise InputError(LIMITS.removesuffix("."))
    model = with_added(identified.model, choice.added)
    off = {p.name: p.neutral for e in model.effects if e.name in choice.off for p in e.parameters}
    every = {p.name: identified.values.get(p.name, p.neutral) for p in model.parameters} | dict(values) | off
    every = {p.name: every[p.name] for p in model.parameters}
    fixed = {name: every[name] for name in (*dict(model.fixed), *off)}
    changes, before = [], identified.values
    for name, x in sorted(every.items(), key=lambda row: row[0] not in before):  # what was moved, then what is new
        if name not in off and x != before.get(name):
            changes.append(f"{name} = {x:.10g} ({f'was {before[name]:.10g}' if name in before else 'new'})")
    changed = ", ".join((*changes, *(f"{name} off" for name in sorted(choice.off))))
    origin = f"Changed by hand with open, SI and radians: {changed}. These values are no estimates."
    sources = (*identified.sources, *((origin,) if changed else ()))
    return replace(identified, model=replace(model, fixed=tuple(fixed.items())), values=every, sources=sources)


def export_chosen(
    opened: OpenedResult, choice: Choice, values: Mapping[str, float], form: str
) -> tuple[Path, list[str]]:
    """Write the chosen model into a new folder below the result; that folder and its files. What is there stays."""
    identified, root = chosen_model(opened, choice, values), opened.folder / "exports"
    names = (f"{identified.name}_{form}{'' if k == 1 else f'_{k}'}" for k in count(1))
    target = next(root / name for name in names if not (root / name).exists() and not (root / name).is_symlink())
    return target, write_export(identified, form, target)["files"]


def linear_groups(linear: IdentifiedLinear, errors: Mapping[str, float]) -> tuple[SliderGroup, ...]:
    """The parameters of each row, every parameter once, with the row that the card writes first; `errors` in SI."""
    rows, free = linear.rows, {p.name: p for p in linear.fitted.free}
    many = {name: linear.fitted.names_of(name) for name in rows.by_manoeuvre}
    titles = [*(f"rate of {name}" for name in rows.states), *(f"output {name}" for name in rows.outputs), "delays"]
    parts = [*([term.parameter for term in row] for _, row in rows.rows), [name for _, name in rows.delays]]
    groups: list[SliderGroup] = []
    for title, part in zip(titles, parts, strict=True):
        names = dict.fromkeys(n for parameter in part for n in many.get(parameter, [parameter]) if n in free)
        chosen = [free.pop(n) for n in names]
        sliders = tuple(slider(p, linear.values[p.name], errors.get(p.name, 0.0), abs(p.start) or 1.0) for p in chosen)
        if sliders:
            groups.append(SliderGroup(title, f"{title} of the linear system", False, sliders, switch=False))
    return tuple(groups)


@dataclass(frozen=True)
class Slider:
    """A parameter in the unit in which people read it, to which `factor` converts SI; `error` 0: unknown."""

    name: str
    unit: str
    factor: float
    description: str
    value: float
    error: float
    low: float
    high: float


@dataclass(frozen=True)
class SliderGroup:
    name: str
    claim: str
    added: bool  # to the result's model
    sliders: tuple[Slider, ...]
    switch: bool = True  # whether it can be switched off


def groups_of(
    model: Model, values: Mapping[str, float], errors: Mapping[str, float], added: Sequence[str] = ()
) -> tuple[SliderGroup, ...]:
    """Every effect that can be switched off, with its sliders; values and standard `errors` in SI."""
    choice = Choice(added=tuple(added))
    flown = flown_model(model, choice)
    begin, parameters = values_of(flown, values, choice), {p.name: p for p in flown.parameters}
    groups = []
    for e in shown_effects(model, added):
        sliders = []
        for p in (parameters[p.name] for p in e.parameters):
            largest = e.sizes.get(p.name, (0.0, 0.0))[1]  # plausible departure from neutral
            if not math.isfinite(p.neutral) or largest <= 0.0:
                largest = abs(p.start) or 1.0
            sliders.append(slider(p, begin[p.name], errors.get(p.name, 0.0), largest))
        groups.append(SliderGroup(e.name, e.claim, e.name in added, tuple(sliders)))
    return tuple(groups)


def slider(p: Parameter, value: float, error: float, largest: float) -> Slider:
    """About `value` by the standard error `error` (0: unknown, then by the departure `largest`), SI."""
    reach = max(ERRORS * error, SHARE * abs(value), 0.0 if error else largest)
    low, high = max(value - reach, p.bounds[0]), min(value + reach, p.bounds[1])
    unit, factor = for_people(p.unit)
    shown = (factor * x for x in (value, error, low, high))
    return Slider(p.name, plain_unit(unit), factor, p.description, *shown)


# --- One manoeuvre of a result, flown again at any values by one compiled function.

DRAWS = 40  # of the fan


@dataclass(frozen=True)
class Flown:
    """A manoeuvre as flown at some values, SI and radians, each quantity (n,)."""

    values: Mapping[str, float]
    simulated: Mapping[str, Float[np.ndarray, " n"]]  # with the model's sensor errors, as a recorder would have them
    coefficients: Mapping[str, Float[np.ndarray, " n"]]  # of the model, along the recorded motion, and X
    formed: Mapping[str, Float[np.ndarray, " n"]]  # from the record under the same values
    inside: Bool[np.ndarray, " n"]  # the envelope until now


Ready = tuple[SegmentTrajectories, EquationError | None, Float[np.ndarray, "1 b"]]
"""A manoeuvre and a model, prepared for the compiled function, and the departure of the initial state."""


@dataclass(frozen=True)
class FlownModel:
    """A model of certain effects (None: a linear system), what flies it, and the integration steps a sample."""

    model: Model | None
    dynamics: Dynamics
    substeps: int


class Simulator:
    """The manoeuvres of a result under its model and under models derived from it; what is prepared is kept."""

    def __init__(self, opened: OpenedResult) -> None:
        self.opened = opened
        self.card, _ = on_recorded_axes(opened.card, opened.flown, OF_AXIS, DERIVED)
        identified = opened.identified
        required = identified.rows.inputs if isinstance(identified, IdentifiedLinear) else FLIGHT
        self.flights, _ = despiked(join(opened.flown, self.card, required))
        self.manoeuvres = self.flights.names
        setting = opened.told.get("setting", {})
        self.held = setting.get("inputs") == HELD
        self.fixed = self.card.fly.initial_state if setting.get("initial_state") == FIXED else None
        self.biases = self.card.output_biases if opened.command == "fly" else {}
        self._ready: dict[Any, Ready] = {}
        self._results: dict[int, Flown] = {}
        self._structures: dict[tuple[tuple[str, ...], frozenset[str]], FlownModel] = {}
        dynamics = self._structure(Choice()).dynamics
        self.outputs = tuple(n for n in dynamics.outputs if n in self.flights.channels)
        self.inputs = tuple(n for n in dynamics.inputs if n in self.flights.channels and n not in self.outputs)
        self.no_coefficients = ""

    def time(self, manoeuvre: int) -> Float[np.ndarray, " n"]:
        return self.flights.time[self.flights.manoeuvre == manoeuvre]

    def recorded(self, manoeuvre: int) -> dict[str, Float[np.ndarray, " n"]]:
        samples = self.flights.manoeuvre == manoeuvre
        return {name: np.asarray(self.flights.channels[name])[samples] for name in (*self.outputs, *self.inputs)}

    def result(self, manoeuvre: int) -> Flown:
        if manoeuvre not in self._results:
            self._results[manoeuvre] = self.fly(manoeuvre, Choice())
        return self._results[manoeuvre]

    def fly(self, manoeuvre: int, choice: Choice) -> Flown:
        values = self._values(choice)
        theta = jnp.asarray(list(values.values()))
        flown, residuals, departure = self._prepared(manoeuvre, choice, values)
        simulated, inside, formed, modelled, X = _fly(flown, residuals, theta, jnp.asarray(departure))
        paths, coefficients = _named(flown, residuals, simulated, modelled, X)
        names = () if residuals is None else residuals.model.coefficients
        measured = {name: np.asarray(formed)[:, k] for k, name in enumerate(names)}
        return Flown(values, paths, coefficients, measured, np.asarray(inside))

    def fan(self, manoeuvre: int, count: int = DRAWS, seed: int = 0) -> tuple[str, dict[str, np.ndarray]]:
        """Outputs and coefficients (m, n) of draws of the result's parameters, and where the draws come from."""
        opened, values = self.opened, self._values(Choice())
        draws = drawn(opened, opened.identified.names, count, seed)
        theta = np.tile(list(values.values()), (count, 1))
        for k, name in enumerate(draws.names):
            if name in values:
                theta[:, list(values).index(name)] = draws.values[:, k]
        flown, residuals, departure = self._prepared(manoeuvre, Choice(), values)
        simulated, _, _, modelled, X = _fly_draws(flown, residuals, jnp.asarray(theta), jnp.asarray(departure))
        paths, coefficients = _named(flown, residuals, simulated, modelled, X)
        return draws.origin, paths | coefficients

    def _structure(self, choice: Choice) -> FlownModel:
        key = choice.added, choice.off
        if key not in self._structures:
            opened = self.opened
            outputs = opened.told.get("fitted_outputs", ()) if opened.command == "fly" else ()
            if isinstance(opened.identified, IdentifiedLinear):  # has nothing to choose
                model, plain = None, opened.identified.dynamics(self.flights)
            else:
                model = flown_model(opened.identified.model, choice)
                plain = aircraft_dynamics(model, self.flights, outputs)
            dynamics = biased_dynamics(plain, self.flights, self.biases)
            steps = dynamics.substeps_at({p.name: p.start for p in dynamics.free}, self.flights)
            self._structures[key] = FlownModel(model, dynamics, steps)
        return self._structures[key]

    def _values(self, choice: Choice) -> dict[str, float]:
        opened, flown = self.opened, self._structure(choice)
        values = opened.identified.values
        chosen = {**values, **choice.values} if flown.model is None else values_of(flown.model, values, choice)
        fitted = {name: p["estimate"] for name, p in opened.told.get("parameters", {}).items()}
        every = {p.name: p.start for p in flown.dynamics.free} | fitted | chosen
        return {name: float(every[name]) for name in flown.dynamics.names}

    def _prepared(self, manoeuvre: int, choice: Choice, values: Mapping[str, float]) -> Ready:
        """Cut and stepped as by `fly`; finer where a lag is now shorter than where that fit begins."""
        flown = self._structure(choice)
        steps = max(flown.substeps, flown.dynamics.substeps_at(values, self.flights))
        key = manoeuvre, flown.dynamics, steps
        if key not in self._ready:
            options = {"outputs": self.outputs, "substeps": steps, "fixed": self.fixed, "held": self.held}
            whole = segments(self.flights, flown.dynamics, **options)
            away = self.opened.departures.get(self.manoeuvres[manoeuvre], {})
            departure = np.array([[away.get(name, 0.0) for name in flown.dynamics.start]])
            alone = whole.part([manoeuvre]).nameless
            n = int(alone.inside.sum())  # without the samples that give all segments one length
            cut = {name: getattr(alone, name)[:, :n] for name in ("index", "inside", "noise_growth")}
            residuals = None
            if flown.model is not None:
                try:
                    record, _ = despiked(join([self.opened.flown[manoeuvre]], self.card))
                    flights = replace(record.nameless, channels=dict(record.channels))
                    residuals = EquationError(flights, flown.model, (), ())
                except InputError as reason:
                    self.no_coefficients = f"Coefficients are not shown: {reason}."
            self._ready[key] = replace(alone, **cut), residuals, departure
        return self._ready[key]


def _named(
    flown: SegmentTrajectories, residuals: EquationError | None, simulated: Any, modelled: Any, X: Any
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Outputs, and coefficients with the separation point, whose names are along the last axis."""
    paths = dict(zip(flown.outputs, np.moveaxis(np.asarray(simulated), -1, 0), strict=True))
    if residuals is None:
        return paths, {}
    modelled = np.moveaxis(np.asarray(modelled), -1, 0)
    return paths, dict(zip(residuals.model.coefficients, modelled, strict=True)) | {"X": np.asarray(X)}


def _one(flown: SegmentTrajectories, residuals: EquationError | None, theta: Any, departure: Any) -> tuple:
    """Simulated outputs (n, c), whether inside, measured and modelled coefficients and X."""
    simulation = simulate(flown, theta, departure)
    paths = (simulation.measured - simulation.residual)[0], simulation.trajectory.inside[0]
    if residuals is None:
        return (*paths, None, None, None)
    _, details = residuals.traced(theta[: len(residuals.model.free)])  # biases of outputs are behind
    return (*paths, details["measured"], details["modelled"], details["X"])


_fly = compiled_at(0)(_one)
_fly_draws = Compiled(eqx.filter_vmap(_one, in_axes=(None, None, 0, None)))
