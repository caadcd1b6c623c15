"""Equation error: measured minus modelled coefficients and flight path, as a function of the parameters of all effects.

Outputs are the coefficients and, where attitude and altitude were recorded, the flight-path integrals. One compiled
function gives the residuals and their sensitivities to all parameters of all effects, active or not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.model.joined_channels import Flights, response_scales
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import Axis
from bayes_aero.physics.coefficients import stacked_coefficients
from bayes_aero.physics.filters import smooth_joined
from bayes_aero.physics.kinematics import LATERAL, PATH
from bayes_aero.residuals.base import Blockwise
from bayes_aero.residuals.flight_path import differences, flight_path

DIRECTIONS_AT_ONCE = 4  # most calls need no more, and larger ones are no slower
RESPONSE = ("q", *PATH, *LATERAL)  # measured channels whose own scale an effect may change
LATERAL_RESPONSE = ("p", "r", "ay")  # and those of the lateral axis


class EquationError(Blockwise, eqx.Module):
    """Residuals of one set of flights under one model of many effects."""

    # Residuals are averaged over m blocks. They are in units of the recorded response: the residual of a coefficient is
    # multiplied by the ratio of its derivatives by the recorded acceleration, with the card's values over with the
    # effect's. Otherwise an effect that rescales the measurement could improve the fit by shrinking its noise. This is
    # the Jacobian term of the likelihood.
    flights: Flights
    model: Model = eqx.field(static=True)
    measuring: tuple[int, ...] = eqx.field(static=True)  # parameters on which the measured coefficients depend
    path: tuple[str, ...] = eqx.field(static=True)  # flight-path outputs

    @classmethod
    def of(cls, flights: Flights, model: Model) -> EquationError:
        """`flights` under `model`."""

        def measured(*theta):
            values = dict(model.fixed) | dict(zip(model.names, theta, strict=True))
            corrected = model.corrected(values, flights.channels, flights.aircraft)
            return corrected, model.actual_aircraft(values, flights.aircraft)

        program = jax.make_jaxpr(measured)(*np.ones(len(model.names))).jaxpr
        read = {id(x) for step in program.eqns for x in step.invars} | {id(x) for x in program.outvars}
        measuring = tuple(i for i, x in enumerate(program.invars) if id(x) in read)
        return cls(flights, model, measuring, flight_path(flights))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs: coefficients, then flight-path channels."""
        return (*self.model.coefficients, *self.path)

    def evaluate(
        self, theta: Float[Array, " k"] | Float[np.ndarray, " k"]
    ) -> tuple[Float[Array, "m c"], dict[str, Array]]:
        """Residuals at the free parameters `theta`, and signals that describe them by name, at the recorded rate."""
        return _evaluate(self.nameless, theta)

    def traced(self, theta: Float[Array, " k"]) -> tuple[Float[Array, "m c"], dict[str, Array]]:
        """`evaluate` as part of a larger compiled program."""
        return _residuals(self, theta)

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions."""
        measuring = np.any(directions[:, list(self.measuring)])
        nothing = np.zeros_like(directions)
        both = (directions, nothing) if measuring else (nothing, directions)
        residual, slope = _linearise(self.nameless, jnp.asarray(theta), *map(jnp.asarray, both))
        return np.asarray(residual), np.asarray(slope)

    def separate_sets(self, columns: Int[np.ndarray, " j"]) -> list[Int[np.ndarray, " i"]]:
        """Parameters that change the measured coefficients cost four times those that change only the modelled ones."""
        measuring = np.isin(columns, self.measuring)
        return [np.flatnonzero(measuring), np.flatnonzero(~measuring)]


class _Signals:
    """Corrected signals of all flights, the aircraft with its corrected constants, and scales of the response."""

    def __init__(self, responses: EquationError, values: Mapping[str, Any]) -> None:
        f, model = responses.flights, responses.model
        self.responses = responses
        self.signals = f.with_slopes(model.corrected(values, f.channels, f.aircraft))
        self.aircraft = model.actual_aircraft(values, f.aircraft)
        response = dict.fromkeys((*RESPONSE, *(LATERAL_RESPONSE if Axis.LATERAL in model.axes else ())))
        self.scales = response_scales(model, values, f.channels, f.aircraft, tuple(response))

    def modelled(self, values: Mapping[str, Any]) -> tuple[Float[Array, "n c"], Float[Array, " n"]]:
        """Coefficients of the model, and the separation point."""
        known = self.responses.model.flow(values, self.signals, self.aircraft)
        return jnp.stack([known[name] for name in self.responses.model.coefficients], axis=-1), known["X"]

    @property
    def factors(self) -> Float[Array, "n c"]:
        """Those that convert residuals of coefficients to units of the recorded response."""
        f, aircraft, scales = self.responses.flights, self.aircraft, self.scales
        pressure = self.signals["density"] * jnp.square(self.signals["airspeed"])
        nominal = f.channels["density"] * jnp.square(f.channels["airspeed"])
        ratio = pressure / nominal
        force = ratio * (f.aircraft.mass / aircraft.mass)
        pitch = ratio * (f.aircraft.Iy / aircraft.Iy) / scales["q"]
        found = {"CL": force, "CD": force, "Cm": pitch}
        if Axis.LATERAL in self.responses.model.axes:
            roll = ratio * (f.aircraft.Ix / aircraft.Ix) / scales["p"]
            yaw = ratio * (f.aircraft.Iz / aircraft.Iz) / scales["r"]
            found |= {"CY": force / scales["ay"], "Cl": roll, "Cn": yaw}
        return jnp.stack([found[name] for name in self.responses.model.coefficients], axis=-1)


def _smoothed(flights: Flights, rows: Float[Array, "n c"]) -> Float[Array, "n c"]:
    """Columns smoothed manoeuvre by manoeuvre."""
    ends = flights.channels["first"], flights.channels["last"]
    return jax.vmap(lambda x: smooth_joined(x, *ends), in_axes=1, out_axes=1)(rows)


def _residuals(responses: EquationError, theta):
    """Residuals of blocks, and signals that describe them."""
    f, model = responses.flights, responses.model
    values = model.values(theta)
    own = _Signals(responses, values)
    measured = stacked_coefficients(own.signals, own.aircraft, model.coefficients)
    modelled, X = own.modelled(values)
    columns = [(measured - modelled) * own.factors]
    if responses.path:
        columns.append(differences(responses.path, own.signals, own.aircraft, own.scales))
    residual = _smoothed(f, jnp.concatenate(columns, axis=1))
    both = _smoothed(f, jnp.concatenate([measured, modelled], axis=1))
    c = len(model.coefficients)
    details = {"X": X, "measured": both[:, :c], "modelled": both[:, c:], "residual": residual}
    return responses.block(residual), {**own.signals, **details}


_evaluate = eqx.filter_jit(_residuals)


@eqx.filter_jit
def _linearise(responses: EquationError, theta, measuring, flowing):
    """Slopes in directions that change the measured coefficients, plus those in directions that do not."""
    # One program for both: most of it is the same, and directions of zeros cost nothing.
    residual, slope = jax.linearize(lambda t: _residuals(responses, t)[0], theta)
    whole = _along(lambda d: -slope(d), measuring)
    f, model = responses.flights, responses.model
    own = _Signals(responses, model.values(theta))
    factors = own.factors
    _, change = jax.linearize(lambda t: own.modelled(model.values(t))[0] * factors, theta)
    coefficients = _along(lambda d: responses.block(_smoothed(f, change(d))), flowing)
    others = residual.shape[1] - len(model.coefficients)
    return residual, whole + jnp.pad(coefficients, ((0, 0), (0, 0), (0, others)))


def _along(slope: Callable[[Array], Array], directions: Float[Array, "d k"]) -> Float[Array, "d m c"]:
    """Slopes in all directions, `DIRECTIONS_AT_ONCE` at a time; groups of zero directions at the end are skipped."""
    groups = directions.reshape(-1, DIRECTIONS_AT_ONCE, directions.shape[1])
    used = jnp.sum(jnp.any(groups != 0.0, axis=(1, 2)))
    shape = jax.eval_shape(slope, directions[0])
    nothing = jnp.zeros((len(groups), DIRECTIONS_AT_ONCE, *shape.shape), shape.dtype)
    found = jax.lax.fori_loop(0, used, lambda i, x: x.at[i].set(jax.vmap(slope)(groups[i])), nothing)
    return found.reshape(-1, *shape.shape)
