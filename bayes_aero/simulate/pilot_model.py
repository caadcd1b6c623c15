"""What the pilot of a requested manoeuvre does, and the state in which the flight begins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from bayes_aero.dynamics.manoeuvres import STALL_BEYOND, commands
from bayes_aero.dynamics.plant import SIDE_FORCE
from bayes_aero.dynamics.simulate import FlightState, Pilot
from bayes_aero.dynamics.trim import level_speed, trimmed
from bayes_aero.effect import Effect
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY, air
from bayes_aero.simulate.manoeuvres import SAMPLES, SURFACES, flight_time, random_pilot
from bayes_aero.simulate.request import RANDOM_STALL, Grid, Request

LOADED = 17631.0  # kg, of the aircraft that the random pilot's thrust was chosen for


def piloted(
    rng: np.random.Generator,
    request: Request,
    grid: Grid,
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    increments: Float[np.ndarray, "n 3"],
    buffet: float,
    chosen: list[Effect],
) -> tuple[Pilot, FlightState]:
    """What the pilot does, and the state in which the flight begins."""
    if request.manoeuvre == RANDOM_STALL:
        needed = {channel for effect in chosen for channel in effect.channels}
        moved = [name for name in SURFACES if {name, f"{name}_left"} & needed]
        drawn = random_pilot(
            rng, max(90.0, request.seconds), model.break_angle(values), np.zeros((SAMPLES, 3)), buffet, moved
        )
        pilot = _sampled(drawn, grid, aircraft.mass / LOADED)
        alpha = float(pilot.alpha[0])
        airspeed = request.airspeed or level_speed(model, values, aircraft, alpha, request.altitude)
        trim = 0.0
    else:
        airspeed = request.airspeed or level_speed(model, values, aircraft, np.deg2rad(6.0), request.altitude)
        level = trimmed(model, values, aircraft, airspeed, request.altitude)
        alpha, trim = level.alpha, level.command
        pressure = 0.5 * float(air(jnp.asarray(request.altitude))[0]) * airspeed**2
        lean = -pressure * float(aircraft.wing_area) * SIDE_FORCE / (float(aircraft.mass) * GRAVITY)
        listed = commands(grid.time, model.break_angle(values) + STALL_BEYOND - alpha, lean)
        command = listed[request.manoeuvre]
        rest, gains = jnp.zeros(grid.n), [jnp.asarray(x) for x in command.gains]
        pilot = Pilot(
            alpha=jnp.asarray(alpha + command.alpha),
            thrust=jnp.asarray(level.thrust * np.maximum(1.0 + command.thrust, 0.1)),
            excitation=jnp.asarray(command.excitation),
            disturbance=jnp.asarray(increments),
            alpha_gain=gains[0],
            rate_gain=gains[1],
            phi=jnp.asarray(command.phi),
            beta=jnp.asarray(command.beta),
            stabilizer=jnp.asarray(command.stabilizer),
            **dict.fromkeys(SURFACES, rest),
            buffet=jnp.asarray(buffet),
            trim_gain=gains[2],
        )
    begin = (airspeed, alpha, alpha, 0.0, request.altitude, 1.0, trim)
    return pilot._replace(disturbance=jnp.asarray(increments)), FlightState(*(jnp.asarray(x) for x in begin))


def _sampled(pilot: Pilot, grid: Grid, weight: Any) -> Pilot:
    """The random pilot's commands at the grid's samples, his thrust in proportion to the aircraft's weight."""
    time = flight_time()

    def at(x: Any, smooth: bool) -> Any:
        x = np.asarray(x)
        if np.ndim(x) != 1:
            return jnp.asarray(x)
        return jnp.asarray(CubicSpline(time, x)(grid.time) if smooth else np.interp(grid.time, time, x))

    found: dict[str, Any] = {
        key: at(x, key in ("phi", "beta")) for key, x in pilot._asdict().items() if key != "disturbance"
    }
    return Pilot(**found | {"thrust": weight * found["thrust"], "disturbance": pilot.disturbance})
