"""Standard flight-test inputs, flown in the simulator from trimmed level flight.

What each excites: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 9; Jategaonkar, *Flight Vehicle System
Identification*, 2nd ed. 2015, ch. 2. Amplitudes are our choice: those of a transport in a flight test.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.plant import SIDE_FORCE, FlightState
from bayes_aero.dynamics.simulate import Pilot, fly
from bayes_aero.dynamics.trim import GRID, Trim, trimmed
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY, air

SECONDS = 60.0  # s, length of every manoeuvre: one shape, one compiled function
RUN_IN = 5.0  # s flown before the record begins
TIGHT, LOOSE = (0.7, 0.2, 0.15), (0.05, 0.0, 0.0)  # elevator gains on alpha, q and the integral of alpha
STALL_BEYOND, STALL_RISE = np.deg2rad(2.0), np.deg2rad(8.0)  # beyond alpha*, or beyond trim without separation
ENVELOPE = {"alpha": (-0.1, 0.45), "airspeed": (45.0, 250.0)}  # rad, m/s: outside, the manoeuvre is refused
MOVED = {"stabilizer_steps": "stabilizer", "sideslip": "beta", "bank_to_bank": "phi"}  # beside elevator and thrust

Series = Float[np.ndarray, " n"]


class Command(NamedTuple):
    """Departures from trim: alpha, excitation, bank, sideslip, stabilizer in rad; thrust as a share of trim's."""

    gains: tuple[float, float, float]
    alpha: Series
    thrust: Series
    excitation: Series
    phi: Series
    beta: Series
    stabilizer: Series


def commands(time: Series, stall: float, lean: float, amplitude: float = 1.0) -> dict[str, Command]:
    """The standard inputs by name.

    `stall` is how far (rad) the slow sweep rises above trim, `lean` the bank per sideslip that keeps the heading.
    `amplitude` multiplies all of them.
    """
    rest, dt = np.zeros_like(time), float(time[1] - time[0])
    none = Command(TIGHT, rest, rest, rest, rest, rest, rest)

    def steps(points: list[tuple[float, float]], smooth: float) -> Series:
        """Levels held from each time (s) on, rounded over `smooth` s."""
        begins, levels = (np.array(x) for x in zip((-np.inf, 0.0), *points, strict=True))
        held = amplitude * levels[np.searchsorted(begins, time, side="right") - 1]
        window = np.hanning(round(smooth / dt) | 1)
        window = window if len(window) > 2 else np.ones(1)
        padded = np.pad(held, len(window) // 2, mode="edge")
        return np.convolve(padded, window / window.sum(), mode="valid")

    def ramps(points: list[tuple[float, float]]) -> Series:
        return amplitude * np.interp(time, *np.array(points).T)

    deg = np.pi / 180.0
    doublets = [(t + s, x * deg) for t in (5.0, 32.0) for s, x in ((0.0, 2.5), (1.5, -2.5), (3.0, 0.0))]
    unit = [(0.0, 2.0), (2.4, -2.0), (4.0, 2.0), (4.8, -2.0), (5.6, 0.0)]
    multistep = [(t + s, x * deg) for t in (5.0, 32.0) for s, x in unit]
    sideslip = steps([(5.0, 5.0 * deg), (20.0, -5.0 * deg), (35.0, 0.0)], 4.0)
    sweep = [(0.0, 0.0), (5.0, 0.0), (32.0, stall), (35.0, stall), (39.0, 0.3 * stall), (45.0, stall), (52.0, 0.0)]
    return {
        "elevator_doublet": none._replace(gains=LOOSE, excitation=steps(doublets, 0.4)),
        "elevator_3211": none._replace(gains=LOOSE, excitation=steps(multistep, 0.4)),
        "slow_stall": none._replace(alpha=ramps(sweep), thrust=ramps([(0.0, 0.0), (5.0, 0.0), (7.0, -0.6)])),
        "thrust_steps": none._replace(thrust=steps([(5.0, 0.6), (18.0, -0.6), (35.0, 0.6), (48.0, 0.0)], 1.5)),
        "sideslip": none._replace(beta=sideslip, phi=lean * sideslip),
        "bank_to_bank": none._replace(
            phi=steps([(5.0, 30 * deg), (20.0, -30 * deg), (35.0, 30 * deg), (50.0, 0.0)], 5)
        ),
        "stabilizer_steps": none._replace(stabilizer=steps([(5.0, 1.0 * deg), (22.0, -1.0 * deg), (40.0, 0.0)], 2.0)),
        "speed_change": none._replace(gains=LOOSE, excitation=steps([(5.0, 1.0 * deg), (12.0, 0.0)], 1.0)),
    }


def fly_standard(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    *,
    airspeed: float,
    altitude: float,
    dt: float,
    amplitude: float = 1.0,
) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, str]]:
    """Channels of every standard manoeuvre without noise, by name; and those that cannot be flown, with the reason.

    `airspeed` in m/s, `altitude` in m; `dt` the sampling time in s. Beside the recorded channels: `X`.
    """
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    trim = trimmed(model, values, aircraft, airspeed, altitude)
    n, before = round(SECONDS / dt) + 1, round(RUN_IN / dt)
    time = (np.arange(n + before) - before) * dt
    star = model.break_angle(values)
    stall = star + STALL_BEYOND - trim.alpha if star < GRID[-1] else STALL_RISE
    pressure = 0.5 * float(air(jnp.asarray(altitude))[0]) * airspeed**2
    lean = -pressure * aircraft.wing_area * SIDE_FORCE / (aircraft.mass * GRAVITY)
    listed = commands(time, float(stall), float(lean), amplitude)
    pilots = [_pilot(command, trim) for command in listed.values()]
    start = FlightState(*(jnp.asarray(x) for x in (airspeed, trim.alpha, trim.alpha, 0.0, altitude, 1.0, trim.command)))
    stacked = Pilot(*(jnp.stack(part) for part in zip(*pilots, strict=True)))
    states, outputs = _fly(model, values, aircraft, stacked, start, jnp.asarray(dt))
    flown, refused = {}, {}
    for k, name in enumerate(listed):
        state = {key: np.asarray(x[k])[before:] for key, x in states._asdict().items()}
        out = {key: np.asarray(x[k])[before:] for key, x in outputs.items()}
        pilot = {key: np.asarray(x[k]) for key, x in stacked._asdict().items()}
        reason = _outside(state)
        if reason:
            refused[name] = reason
        else:
            flown[name] = _channels(state, out, {key: x[before:] for key, x in pilot.items() if x.ndim}, dt)
    return flown, refused


_fly = eqx.filter_jit(eqx.filter_vmap(fly, in_axes=(None, None, None, 0, None, None)))


def _pilot(command: Command, trim: Trim) -> Pilot:
    rest = jnp.zeros(len(command.alpha))
    gains = [jnp.asarray(x) for x in command.gains]
    return Pilot(
        alpha=jnp.asarray(trim.alpha + command.alpha),
        thrust=jnp.asarray(trim.thrust * np.maximum(1.0 + command.thrust, 0.1)),
        excitation=jnp.asarray(command.excitation),
        disturbance=jnp.zeros((len(command.alpha), 3)),
        alpha_gain=gains[0],
        rate_gain=gains[1],
        phi=jnp.asarray(command.phi),
        beta=jnp.asarray(command.beta),
        stabilizer=jnp.asarray(command.stabilizer),
        rudder=rest,
        spoiler=rest,
        dlc=rest,
        flap=rest,
        buffet=jnp.asarray(0.0),
        trim_gain=gains[2],
    )


def _outside(state: Mapping[str, np.ndarray]) -> str | None:
    for name, x in (("alpha", state["alpha"]), ("airspeed", state["V"])):
        lower, upper = ENVELOPE[name]
        if not (np.all(np.isfinite(x)) and x.min() >= lower and x.max() <= upper):
            return f"{name} leaves its envelope of {lower:g} to {upper:g}"
    return None


def _channels(
    state: Mapping[str, np.ndarray], out: Mapping[str, np.ndarray], pilot: Mapping[str, np.ndarray], dt: float
) -> dict[str, np.ndarray]:
    density, sound = (np.asarray(x) for x in air(jnp.asarray(state["h"])))
    turn = out["psi_dot"]
    both = {f"{name}_{side}": pilot[name] for name in ("spoiler", "dlc") for side in ("left", "right")}
    return {key: out[key] for key in ("ax", "ay", "az", "p", "r", "elevator", "X")} | {
        "q": state["q"],
        "phi": pilot["phi"],
        "theta": state["theta"],
        "psi": np.concatenate([[0.0], np.cumsum(0.5 * dt * (turn[1:] + turn[:-1]))]),
        "alpha": state["alpha"],
        "beta": pilot["beta"],
        "airspeed": state["V"],
        "altitude": state["h"],
        "mach": state["V"] / sound,
        "density": density,
        "thrust": pilot["thrust"],
        "thrust_left": pilot["thrust"] / 2.0,
        "thrust_right": pilot["thrust"] / 2.0,
        "stabilizer": out["stabilizer"],
        **{name: pilot[name] for name in ("rudder", "flap")},
        **both,
    }
