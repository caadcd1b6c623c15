"""The part of trajectories.json that tells of modes of motion and objective tests."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from bayes_aero.diagnosis.trajectories.motion.results import Compared, FlownMode, Motion


def motion_results(found: Motion) -> dict[str, Any]:
    """Plain numbers and text, SI and radians."""
    return {
        "airspeed": found.airspeed,
        "altitude": found.altitude,
        "estimates": "process noise" if found.filtered else "output error",
        "modes": [_mode(mode) for mode in found.modes],
        "why_no_modes": found.why_not,
        "tests": [_test(row, found) for row in found.tests],
        "untested": {
            test: {why: list(manoeuvres) for why, manoeuvres in reasons.items()}
            for test, reasons in found.untested.items()
        },
    }


def _mode(mode: FlownMode) -> dict[str, Any]:
    return {
        "name": mode.name,
        "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
        "eigenvalue_sd": list(mode.sd),
        **{name: {"value": value, "sd": sd} for name, (value, sd) in mode.quantities.items()},
    }


def _test(row: Compared, found: Motion) -> dict[str, Any]:
    measured, sd = row.measured
    return asdict(row) | {"measured": measured, "measured_sd": sd, "source": found.sources[f"{row.entry} {row.test}"]}
