"""Simulated records: request, manoeuvres, sensors and their faults, hidden effects."""

from typing import Literal

SimulatedNoise = Literal["none", "white", "ar1", "buffet"]
Manoeuvre = Literal[
    "random_stall", "slow_stall", "elevator_doublet", "elevator_3211", "multisine", "thrust_steps", "speed_change",
    "sideslip", "bank_to_bank", "stabilizer_steps", "aileron_doublet", "rudder_doublet", "stall_with_bank",
    "engine_steps",
]  # fmt: skip
