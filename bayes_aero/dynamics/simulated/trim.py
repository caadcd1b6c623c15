"""Trim of any model, found from its own coefficients: level flight, its airspeed, and the control that pitches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.simulated.plant import CONTROLS, SIGNALS
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY, air
from bayes_aero.physics.forces import moments, specific_force

GRID = np.deg2rad(np.linspace(-4.0, 20.0, 97))  # alpha tried for trim
TRAVEL = 0.2  # rad either side of the pilot's command over which the pitch acceleration is taken as linear

Values = Mapping[str, Any]


class Trim(NamedTuple):
    """Level flight: angle of attack in rad, thrust in N, the pilot's command beyond that of attached flow in rad."""

    alpha: float
    thrust: float
    command: float


class Lead(NamedTuple):
    """How a model is led along alpha: the share of the command in each of `CONTROLS`, and the command over alpha."""

    shares: Float[Array, " 2"]
    command: Float[Array, "*n"]


def at_rest(alpha: Any, airspeed: Any, altitude: Any) -> dict[str, Any]:
    """Signals of steady flight without rates, thrust, sideslip or deflections, each of the shape of `alpha`."""
    zero = jnp.zeros_like(alpha)
    density, sound = air(zero + altitude)
    rest = dict.fromkeys((*SIGNALS, "aileron"), zero) | {"alpha": alpha, "theta": alpha, "airspeed": zero + airspeed}
    return rest | {"altitude": zero + altitude, "mach": airspeed / sound, "density": density}


def lead(model: Model, values: Values, aircraft: Aircraft, alpha: Float[Array, "*n"], airspeed: Any, altitude: Any):
    """`Lead` along `alpha` (rad) by the first of `CONTROLS` that pitches the model; a command of 0 where none does.

    A positive command pitches down. It balances the pitching moment of attached flow by one Newton step from zero:
    what that leaves is for feedback and trim.
    """
    rest = at_rest(jnp.asarray(0.0), airspeed, altitude)

    def moment(deflections):
        signals = rest | dict(zip(CONTROLS, deflections, strict=True))
        return model.flow(values, signals, aircraft, X=jnp.asarray(1.0))["Cm"]

    slopes = jax.jacfwd(moment)(jnp.zeros(len(CONTROLS)))
    works = slopes != 0.0
    first = jnp.where(jnp.any(works), works & (jnp.cumsum(works) == 1), jnp.arange(len(CONTROLS)) == 0)
    effectiveness = jnp.sum(first * jnp.abs(slopes))
    Cm = model.attached(values, at_rest(alpha, airspeed, altitude), aircraft)["Cm"]
    command = jnp.where(effectiveness > 0.0, Cm / jnp.where(effectiveness > 0.0, effectiveness, 1.0), 0.0)
    return Lead(jnp.where(first, jnp.where(slopes > 0.0, -1.0, 1.0), 0.0), command)


def level_speed(
    model: Model, values: Values, aircraft: Aircraft, alpha: float, altitude: float, mach: float | None = None
) -> float:
    """Airspeed at which the attached lift carries the weight, controls at rest, m/s; `mach` given is not adjusted."""
    numbers = {name: float(x) for name, x in values.items()}
    density = float(air(jnp.asarray(altitude))[0])
    area, speed = float(aircraft.wing_area), 60.0
    for _ in range(20):
        signals = {name: np.asarray(x) for name, x in at_rest(jnp.asarray(alpha), speed, altitude).items()}
        signals |= {} if mach is None else {"mach": np.asarray(mach)}
        CL = float(model.attached(numbers, signals, aircraft)["CL_attached"])
        speed = float(np.sqrt(2.0 * float(aircraft.mass) * GRAVITY / (density * area * CL)))
    return speed


def trimmed(model: Model, values: Values, aircraft: Aircraft, airspeed: float, altitude: float) -> Trim:
    """Angle of attack, thrust and command of level flight.

    Args:
        model: effects in flight.
        values: all parameter values by name.
        aircraft: the actual aircraft.
        airspeed: in m/s.
        altitude: in m.

    Raises:
        InputError: lift cannot carry the weight, or no control pitches the model.
    """
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    pressure = 0.5 * float(air(jnp.asarray(altitude))[0]) * airspeed**2 * aircraft.wing_area
    weight, nothing = float(aircraft.mass) * GRAVITY, np.zeros_like(GRID)
    CL, CD, _ = _balance(model, values, aircraft, airspeed, altitude, GRID, nothing, nothing)
    lift = pressure * (np.asarray(CL) + np.asarray(CD) * np.tan(GRID))
    enough = np.flatnonzero(lift >= weight)
    if not len(enough) or enough[0] == 0:
        raise InputError(f"level flight at {airspeed:.0f} m/s and {altitude:.0f} m needs no angle of attack in range")
    i = int(enough[0])
    alpha = float(np.interp(weight, lift[i - 1 : i + 1], GRID[i - 1 : i + 1]))
    thrust = pressure * float(np.interp(alpha, GRID, np.asarray(CD))) / np.cos(alpha)
    tried = np.linspace(-TRAVEL, TRAVEL, len(GRID))
    moment = np.asarray(
        _balance(model, values, aircraft, airspeed, altitude, alpha + nothing, thrust + nothing, tried)[2]
    )
    if np.ptp(moment) == 0.0:
        raise InputError(f"the model cannot be trimmed: neither {' nor '.join(CONTROLS)} pitches it")
    slope, offset = np.polyfit(tried, moment, 1)
    return Trim(alpha, float(thrust), float(-offset / slope))


@eqx.filter_jit
def _balance(model: Model, values: Any, aircraft: Aircraft, airspeed: Any, altitude: Any, *rows: Any):
    """CL, CD and pitch acceleration in steady level flight at each alpha, thrust and further command of `rows`."""
    alpha, thrust, further = (jnp.asarray(row) for row in rows)
    shares, command = lead(model, values, aircraft, alpha, airspeed, altitude)
    controls = {name: share * (command + further) for name, share in zip(CONTROLS, shares, strict=True)}
    s = at_rest(alpha, airspeed, altitude) | {"thrust": thrust} | controls
    static = model.static_separation(values, s, aircraft)
    known = model.flow(values, s, aircraft, X=jnp.where(model.lag(values) > 0.0, 1.0, static))
    pressure = 0.5 * s["density"] * jnp.square(s["airspeed"])
    fx, fz = specific_force(known["CL"], known["CD"], alpha, pressure, thrust, aircraft)
    pitching = moments(known, (fx, jnp.zeros_like(fx), fz), s, aircraft)[1]
    return known["CL"], known["CD"], pitching / aircraft.Iy
