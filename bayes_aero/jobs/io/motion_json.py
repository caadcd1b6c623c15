"""The part of trajectories.json that tells of modes of motion."""

from __future__ import annotations

from typing import Any

from bayes_aero.diagnosis.trajectories.motion.results import FlownMode, Motion


def motion_results(found: Motion) -> dict[str, Any]:
    """Plain numbers and text, SI and radians."""
    return {
        "airspeed": found.airspeed,
        "altitude": found.altitude,
        "estimates": "process noise" if found.filtered else "output error",
        "modes": [_mode(mode) for mode in found.modes],
        "why_no_modes": found.why_not,
    }


def _mode(mode: FlownMode) -> dict[str, Any]:
    return {
        "name": mode.name,
        "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
        "eigenvalue_sd": list(mode.sd),
        **{name: {"value": value, "sd": sd} for name, (value, sd) in mode.quantities.items()},
    }
