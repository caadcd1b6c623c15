"""Two simulated stall manoeuvres, made anew from this recipe whenever no record is given."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.simulate import FlightState, Pilot, fly
from bayes_aero.flight.card.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.physics.atmosphere import air

SEED = 20150101
DT = 0.04  # s
DURATION = 90.0  # s
NAMES = ("demo_stall_1", "demo_stall_2")

TRUTH: dict[str, float] = {
    "CL0": 0.15,
    "CLa": 3.6,
    "CLaM": 7.0,
    "Cm0": 0.06,
    "Cma": -0.35,
    "Cmq": -8.0,
    "Cmde": -0.70,
    "CD0": 0.045,
    "e": 0.85,
    "CDX": 0.10,
    "CmX": -0.10,
    "a1": 25.0,
    "alpha_star": 0.27,
    "tau1": 0.0,
    "tau2": 20.0,
}
"""Parameters of the simulated aircraft: round numbers near those of a small transport."""

SPREAD, USUAL_SPREAD = {"alpha_star": 0.08, "e": 0.10}, 0.12
"""Of aircraft drawn near it: relative, either way; the usual one of parameters that are not listed."""

DISTURBANCE = {
    "sigma_CL": 0.012,
    "sigma_CD": 0.003,
    "sigma_Cm": 0.001,
    "rho_CL": 0.5,
    "rho_CD": 0.3,
    "rho_Cm": 0.8,
}
"""Turbulence and the like: first-order autoregressive increments of the coefficients."""


def _alpha_command(time: np.ndarray, peaks: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Slow approach to the stall, then excursions past it, in rad: straight lines between (time s, alpha deg)."""
    t, alpha = np.array(peaks).T
    return np.deg2rad(np.interp(time, t, alpha))


def _excitation(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Elevator 3-2-1-1 sequences, 0.8 s a unit and 1.5 deg, at four random times, rounded as by an actuator."""
    signal = np.zeros_like(time)
    for begin in np.sort(rng.uniform(5.0, DURATION - 10.0, 4)):
        for sign, first, last in ((1, 0.0, 2.4), (-1, 2.4, 4.0), (1, 4.0, 4.8), (-1, 4.8, 5.6)):
            signal[(time >= begin + first) & (time < begin + last)] = sign * np.deg2rad(1.5)
    window = np.hanning(11)
    return np.convolve(signal, window / window.sum(), mode="same")


PROFILES = (
    ((0, 6), (10, 6), (40, 15), (44, 17), (47, 11), (54, 16.5), (58, 12), (66, 17.5), (70, 8), (90, 6)),
    ((0, 7), (8, 6), (30, 14), (35, 17.5), (39, 12), (46, 17), (50, 10), (58, 16), (61, 17), (66, 7), (90, 5)),
)


def simulate_stall(
    number: int,
    *,
    card: Card | None = None,
    seed: int = SEED,
    sensor_noise: float = 1.0,
    disturbance: float = 1.0,
) -> FlightRecord:
    """Manoeuvre 0 or 1 of the recipe; `sensor_noise` and `disturbance` scale what the card and the recipe state."""
    card = card or read_card("attas")
    model = Model.of(card.effects)
    rng = np.random.default_rng([seed, number])
    time = np.arange(round(DURATION / DT) + 1) * DT
    n = len(time)
    white = jnp.asarray(rng.standard_normal((n, 3)))
    start_flag = jnp.asarray(np.arange(n) == 0)
    increments = Noise(Colour.AR1).simulate(DISTURBANCE, white, jnp.ones(n), start_flag)
    idle, cruise = 5_000.0, 22_000.0
    pilot = Pilot(
        alpha=jnp.asarray(_alpha_command(time, PROFILES[number])),
        thrust=jnp.asarray(
            np.interp(time, [0, 5, 8, DURATION - 20, DURATION - 14], [cruise, cruise, idle, idle, cruise])
        ),
        excitation=jnp.asarray(_excitation(time, rng)),
        disturbance=disturbance * increments,
        alpha_gain=jnp.asarray(0.7),
        rate_gain=jnp.asarray(0.2),
    )
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    alpha0 = float(pilot.alpha[0])
    start = FlightState(*(jnp.asarray(x) for x in (95.0, alpha0, alpha0, 0.0, 5200.0, 1.0)))
    states, outputs = fly(model, values, card.aircraft, pilot, start, DT)
    outputs = {key: np.asarray(value) for key, value in outputs.items()}
    return _record(NAMES[number], time, states, outputs, pilot, card, rng, sensor_noise)


def _record(
    name: str,
    time: Float[np.ndarray, " n"],
    states: FlightState,
    outputs: Mapping[str, np.ndarray],
    pilot: Pilot,
    card: Card,
    rng: np.random.Generator,
    sensor_noise: float,
) -> FlightRecord:
    """What the recorder would have stored: true signals plus white sensor noise; lateral channels at rest."""
    density, sound = air(states.h)
    rest = np.zeros_like(time)
    channels = {
        "ax": outputs["ax"],
        "ay": rest,
        "az": outputs["az"],
        "p": rest,
        "q": states.q,
        "r": rest,
        "phi": rest,
        "theta": states.theta,
        "psi": rest,
        "alpha": states.alpha,
        "beta": rest,
        "airspeed": states.V,
        "altitude": states.h,
        "elevator": outputs["elevator"],
        "mach": states.V / sound,
        "density": density,
        "thrust_left": pilot.thrust / 2,
        "thrust_right": pilot.thrust / 2,
    }
    noisy = {
        key: np.asarray(values) + sensor_noise * card.sensors.get(key, 0.0) * rng.standard_normal(len(time))
        for key, values in channels.items()
    }
    return FlightRecord.from_arrays(name=name, time=time, channels=noisy, source="simulated")


def demo_records() -> list[FlightRecord]:
    """The two manoeuvres on which the program runs when it is given no record."""
    return [simulate_stall(number) for number in range(len(NAMES))]
