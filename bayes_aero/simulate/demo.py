"""Two simulated stall manoeuvres, made anew from this recipe whenever no record is given."""

from __future__ import annotations

import numpy as np

from bayes_aero.dynamics.simulated.manoeuvres import pulses, ramps, rounded, three_two_one_one
from bayes_aero.dynamics.simulated.simulate import FlightState, Pilot, fly
from bayes_aero.flight.card.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.physics.coefficient_names import NAMES
from bayes_aero.simulate.manoeuvres import CRUISE, DT, IDLE, autoregressive

SEED = 20150101
DURATION = 90.0  # s
RECORDS = ("demo_stall_1", "demo_stall_2")

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

LATERAL_TRUTH: dict[str, float] = {
    "CYbe": -0.75,
    "CYr": 0.3,
    "CYdr": 0.2,
    "Clbe": -0.1,
    "Clp": -0.45,
    "Clr": 0.15,
    "Clda": -0.12,
    "Cldr": 0.02,
    "Cnbe": 0.13,
    "Cnp": -0.06,
    "Cnr": -0.2,
    "Cnda": 0.01,
    "Cndr": -0.09,
}
"""The same of its lateral derivatives, for cards that model the lateral axis; rates by b/2V."""

LATERAL_EFFECTS = (
    "sideslip_side_force", "yaw_rate_side_force", "rudder_side_force", "sideslip_roll", "roll_damping", "yaw_rate_roll",
    "aileron_roll", "rudder_roll", "sideslip_yaw", "roll_rate_yaw", "yaw_damping", "aileron_yaw", "rudder_yaw",
)  # fmt: skip
"""The effects that own them."""

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


PROFILES = (
    ((0, 6), (10, 6), (40, 15), (44, 17), (47, 11), (54, 16.5), (58, 12), (66, 17.5), (70, 8), (90, 6)),
    ((0, 7), (8, 6), (30, 14), (35, 17.5), (39, 12), (46, 17), (50, 10), (58, 16), (61, 17), (66, 7), (90, 5)),
)
"""Of alpha: slow approach to the stall, then excursions past it; straight lines between (time s, alpha deg)."""


RECORDED = (
    "ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "airspeed", "altitude", "elevator", "mach",
    "density",
)  # fmt: skip
"""Channels of the record beside the engines' thrust, in the order in which their noise is drawn."""


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
    white = rng.standard_normal((len(time), 3))
    increments = autoregressive(white, *([DISTURBANCE[f"{x}_{c}"] for c in NAMES] for x in ("rho", "sigma")))
    begins = np.sort(rng.uniform(5.0, DURATION - 10.0, 4))
    excitation = pulses(time, [part for begin in begins for part in three_two_one_one(begin, 0.8, np.deg2rad(1.5))])
    power = [(0, CRUISE), (5, CRUISE), (8, IDLE), (DURATION - 20, IDLE), (DURATION - 14, CRUISE)]
    pilot = Pilot(
        alpha=np.deg2rad(ramps(time, PROFILES[number])),
        thrust=ramps(time, power),
        excitation=rounded(excitation, 0.4, DT),
        disturbance=disturbance * increments,
    )
    alpha = float(pilot.alpha[0])
    flight = fly(model, TRUTH, card.aircraft, pilot, FlightState(95.0, alpha, alpha, 0.0, 5200.0), DT)
    half = np.asarray(pilot.thrust) / 2
    flown = {name: np.asarray(flight[name]) for name in RECORDED} | {"thrust_left": half, "thrust_right": half}
    channels = {
        name: x + sensor_noise * card.sensors.get(name, 0.0) * rng.standard_normal(len(time))
        for name, x in flown.items()
    }
    return FlightRecord.from_arrays(name=RECORDS[number], time=time, channels=channels, source="simulated")


def demo_records() -> list[FlightRecord]:
    """The two manoeuvres on which the program runs when it is given no record."""
    return [simulate_stall(number) for number in range(len(RECORDS))]
