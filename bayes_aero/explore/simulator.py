"""One manoeuvre of a result, flown again at any values by one compiled function."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.dynamics.flight import DERIVED, Dynamics, aircraft_dynamics, biased_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, segments, simulate
from bayes_aero.errors import InputError
from bayes_aero.explore.opened import Choice, OpenedResult, flown_model, values_of
from bayes_aero.jobs.fitted import IdentifiedLinear, drawn
from bayes_aero.jobs.options import FIXED, HELD
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join
from bayes_aero.model.records import on_recorded_axes
from bayes_aero.physics.aircraft import FLIGHT, OF_AXIS
from bayes_aero.residuals.equation_error import EquationError

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
        """Join the records."""
        self.opened = opened
        self.card, _ = on_recorded_axes(opened.card, opened.records, OF_AXIS, DERIVED)
        found = opened.identified
        required = found.rows.inputs if isinstance(found, IdentifiedLinear) else FLIGHT
        self.flights, _ = despiked(join(opened.records, self.card, required))
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

    @property
    def manoeuvres(self) -> tuple[str, ...]:
        """Names of the manoeuvres."""
        return self.flights.names

    def time(self, manoeuvre: int) -> Float[np.ndarray, " n"]:
        """Time from the start of the record, s."""
        return self.flights.time[self.flights.manoeuvre == manoeuvre]

    def recorded(self, manoeuvre: int) -> dict[str, Float[np.ndarray, " n"]]:
        """Recorded outputs and inputs."""
        own = self.flights.manoeuvre == manoeuvre
        return {name: np.asarray(self.flights.channels[name])[own] for name in (*self.outputs, *self.inputs)}

    def result(self, manoeuvre: int) -> Flown:
        """The manoeuvre at the values of the result; flown once."""
        if manoeuvre not in self._results:
            self._results[manoeuvre] = self.fly(manoeuvre, Choice())
        return self._results[manoeuvre]

    def fly(self, manoeuvre: int, choice: Choice) -> Flown:
        """The manoeuvre at the chosen values."""
        values = self._values(choice)
        theta = jnp.asarray(list(values.values()))
        flown, residuals, departure = self._prepared(manoeuvre, choice, values)
        simulated, inside, formed, modelled, X = _fly(flown, residuals, theta, jnp.asarray(departure))
        found: dict[str, Any] = {}
        measured: dict[str, Any] = {}
        if residuals is not None:
            names = residuals.model.coefficients
            found = dict(zip(names, np.asarray(modelled).T, strict=True)) | {"X": np.asarray(X)}
            measured = dict(zip(names, np.asarray(formed).T, strict=True))
        paths = dict(zip(flown.outputs, np.asarray(simulated).T, strict=True))
        return Flown(values, paths, found, measured, np.asarray(inside))

    def fan(self, manoeuvre: int, count: int = DRAWS, seed: int = 0) -> tuple[str, dict[str, np.ndarray]]:
        """Outputs and coefficients (m, n) of draws of the result's parameters, and where the draws come from."""
        opened, values = self.opened, self._values(Choice())
        draws = drawn(opened.identified, opened.folder, opened.told, opened.identified.names, count, seed)
        theta = np.tile(list(values.values()), (count, 1))
        for k, name in enumerate(draws.names):
            if name in values:
                theta[:, list(values).index(name)] = draws.values[:, k]
        flown, residuals, departure = self._prepared(manoeuvre, Choice(), values)
        simulated, _, _, modelled, X = _fly_draws(flown, residuals, jnp.asarray(theta), jnp.asarray(departure))
        found = dict(zip(flown.outputs, np.moveaxis(np.asarray(simulated), 2, 0), strict=True))
        if residuals is not None:
            found |= dict(zip(residuals.model.coefficients, np.moveaxis(np.asarray(modelled), 2, 0), strict=True))
            found["X"] = np.asarray(X)
        return draws.origin, found

    def _structure(self, choice: Choice) -> FlownModel:
        key = choice.added, choice.off
        if key not in self._structures:
            opened = self.opened
            asked = opened.told.get("fitted_outputs", ()) if opened.command == "fly" else ()
            if isinstance(opened.identified, IdentifiedLinear):  # has nothing to choose
                model, plain = None, opened.identified.dynamics(self.flights)
            else:
                model = flown_model(opened.identified.model, choice)
                plain = aircraft_dynamics(model, self.flights, asked)
            dynamics = biased_dynamics(plain, self.flights, self.biases)
            steps = dynamics.substeps_at({p.name: p.start for p in dynamics.free}, self.flights)
            self._structures[key] = FlownModel(model, dynamics, steps)
        return self._structures[key]

    def _values(self, choice: Choice) -> dict[str, float]:
        """Of the model and of the biases of outputs."""
        opened, own = self.opened, self._structure(choice)
        values = opened.identified.values
        found = {**values, **choice.values} if own.model is None else values_of(own.model, values, choice)
        fitted = {name: p["estimate"] for name, p in opened.told.get("parameters", {}).items()}
        every = {p.name: p.start for p in own.dynamics.free} | fitted | found
        return {name: float(every[name]) for name in own.dynamics.names}

    def _prepared(self, manoeuvre: int, choice: Choice, values: Mapping[str, float]) -> Ready:
        """Cut and stepped as by `fly`; finer where a lag is now shorter than where that fit begins."""
        own = self._structure(choice)
        steps = max(own.substeps, own.dynamics.substeps_at(values, self.flights))
        key = manoeuvre, own.dynamics, steps
        if key not in self._ready:
            options = {"outputs": self.outputs, "substeps": steps, "fixed": self.fixed, "held": self.held}
            whole = segments(self.flights, own.dynamics, **options)
            away = self.opened.departures.get(self.manoeuvres[manoeuvre], {})
            departure = np.array([[away.get(name, 0.0) for name in own.dynamics.start]])
            alone = whole.part([manoeuvre]).nameless
            n = int(alone.inside.sum())  # without the samples that give all segments one length
            cut = {name: getattr(alone, name)[:, :n] for name in ("index", "inside", "noise_growth")}
            residuals = None
            if own.model is not None:
                try:
                    record, _ = despiked(join([self.opened.records[manoeuvre]], self.card))
                    flights = replace(record.nameless, channels=dict(record.channels))
                    residuals = EquationError(flights, own.model, (), ())
                except InputError as reason:
                    self.no_coefficients = f"Coefficients are not shown: {reason}."
            self._ready[key] = replace(alone, **cut), residuals, departure
        return self._ready[key]


def _one(flown: SegmentTrajectories, residuals: EquationError | None, theta: Any, departure: Any) -> tuple:
    """Simulated outputs (n, c), whether inside, measured and modelled coefficients and X."""
    found = simulate(flown, theta, departure)
    paths = (found.measured - found.residual)[0], found.trajectory.inside[0]
    if residuals is None:
        return (*paths, None, None, None)
    own = theta[: len(residuals.model.free)]  # biases of outputs are behind
    _, details = residuals.traced(own)
    return (*paths, details["measured"], details["modelled"], details["X"])


_fly = eqx.filter_jit(_one)
_fly_draws = eqx.filter_jit(eqx.filter_vmap(_one, in_axes=(None, None, 0, None)))
