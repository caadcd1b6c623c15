"""The part of diagnosis.json that tells of simulated trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_aero.diagnosis.trajectories.results import (
    Error,
    FlownMode,
    LagTest,
    Motion,
    SimulatedManoeuvre,
    Trajectories,
)
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS

PARTS = ("bias", "variance", "covariance")  # of Theil's coefficient


def trajectory_results(flown: Trajectories, card: Card) -> dict[str, Any]:
    """Errors by manoeuvre, model and split; parameters; tolerances with their sources. SI throughout."""
    before, after = flown.card, flown.extended
    return {
        "fitted_outputs": list(flown.fitted),
        "status": {"card": before.status.name, "extended": after.status.name},
        "at_bound": {"card": list(before.at_bound), "extended": list(after.at_bound)},
        "variance_inflation": flown.variance_inflation,
        "noise_growth": dict(flown.noise_growth),
        "lag": None if flown.lag is None else _lag(flown.lag),
        "causes": {
            name: {"elpd": elpd, "elpd_se": elpd_se, "kept": name in flown.asked.kept}
            for name, (elpd, elpd_se) in flown.asked.missed.items()
        },
        "tolerances": {
            name: {"value": t.value, "unit": STANDARD_CHANNELS[name].unit, "source": t.source}
            for name, t in card.tolerances.items()
            if name in flown.outputs
        },
        "paths": [path_results(path) for path in flown.paths],
        "held_without": {name: list(held) for name, held in flown.held.items()},
        "parameters": {
            name: {
                "card": before.values.get(name),
                "extended": value,
                "sd": flown.deviation[name],
                "unit": after.units[name],
                "held_by_prior": name in after.held,
                "at_bound": name in after.at_bound,
            }
            for name, value in after.values.items()
        },
    }


def path_results(path: SimulatedManoeuvre, units: Mapping[str, str] | None = None) -> dict[str, Any]:
    """One simulated manoeuvre; `units` of outputs (SI) for channels that the program does not know by name."""
    known = units or {name: STANDARD_CHANNELS[name].unit for name in path.errors}
    return {
        "manoeuvre": path.manoeuvre,
        "model": path.model,
        "split": path.split,
        "inside_envelope": path.inside,
        "outputs": {name: _error(known[name], error) for name, error in path.errors.items()},
    }


def open_loop(path: SimulatedManoeuvre, units: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The same of a flight that has no other beside it: neither a split nor a chance to stay inside."""
    told = path_results(path, units)
    del told["split"]
    for error in told["outputs"].values():
        del error["probability_within"]  # of hold-out flights only
    return told


def _error(unit: str, error: Error) -> dict[str, Any]:
    return {
        "unit": unit,
        "rms": error.rms,
        "largest": error.largest,
        "theil": error.theil.theil,
        **{f"theil_{part}": getattr(error.theil, part) for part in PARTS},
        "within_tolerance": error.within,
        "probability_within": error.probability,
    }


def _lag(lag: LagTest) -> dict[str, Any]:
    elpd, elpd_se = lag.unseen
    unseen = {"elpd": elpd, "elpd_se": elpd_se}
    told = {"effect": lag.effect, "gain": lag.gain, "hold_out": unseen, "kept": lag.kept}
    return told | {"instead_of": list(lag.instead), "slight": lag.slight}


# --- The part of trajectories.json that tells of modes of motion.


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
