"""The part of diagnosis.json that tells of simulated trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_aero.criticism.trajectory import Error, Path, Trajectories
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS


def trajectory_results(flown: Trajectories, card: Card) -> dict[str, Any]:
    """Errors by manoeuvre, model and split; parameters; tolerances with their sources. SI throughout."""
    names, card_values = flown.extended.names, dict(zip(flown.card.names, flown.card.estimate, strict=True))
    return {
        "fitted_outputs": list(flown.extended.flown.outputs),
        "status": {"card": flown.card.status.name, "extended": flown.extended.status.name},
        "colour_cost": flown.colour_cost,
        "tolerances": {
            name: {"value": t.value, "unit": STANDARD_CHANNELS[name].unit, "source": t.source}
            for name, t in card.tolerances.items()
            if name in flown.outputs
        },
        "paths": [path_results(path) for path in flown.paths],
        "held_without": {name: list(held) for name, held in flown.held.items()},
        "parameters": {
            name: {
                "card": float(card_values[name]) if name in card_values else None,
                "extended": float(flown.extended.estimate[i]),
                "sd": float(flown.deviation[i]),
                "unit": flown.extended.parameters[i].unit,
                "held_by_prior": name in flown.extended.held,
                "at_bound": name in flown.extended.at_bound,
            }
            for i, name in enumerate(names)
        },
    }


def path_results(path: Path, units: Mapping[str, str] | None = None) -> dict[str, Any]:
    """One simulated manoeuvre; `units` of outputs (SI) for channels that the program does not know by name."""
    known = units or {name: STANDARD_CHANNELS[name].unit for name in path.errors}
    return {
        "manoeuvre": path.manoeuvre,
        "model": path.model,
        "split": path.split,
        "inside_envelope": path.inside,
        "outputs": {name: _error(known[name], error) for name, error in path.errors.items()},
    }


def _error(unit: str, error: Error) -> dict[str, Any]:
    return {
        "unit": unit,
        "rms": error.rms,
        "largest": error.largest,
        "theil": error.theil.theil,
        "theil_bias": error.theil.bias,
        "theil_variance": error.theil.variance,
        "theil_covariance": error.theil.covariance,
        "within_tolerance": error.within,
        "probability_within": error.probability,
    }
