"""The part of diagnosis.json that tells of simulated trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_aero.diagnosis.trajectories.results import Motion, SimulatedManoeuvre, Trajectories
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.jobs.provenance import named_pairs, picked


def trajectory_results(flown: Trajectories, card: Card) -> dict[str, Any]:
    """Errors by manoeuvre, model and split; parameters; tolerances with their sources. SI throughout."""
    before, after, lag = flown.card, flown.extended, flown.lag
    return {
        "fitted_outputs": list(flown.fitted),
        "status": {"card": before.status.name, "extended": after.status.name},
        "at_bound": {"card": list(before.at_bound), "extended": list(after.at_bound)},
        **picked(flown, "variance_inflation", "noise_growth"),
        "lag": None
        if lag is None
        else {
            **picked(lag, "effect", "gain"),
            "hold_out": dict(zip(("elpd", "elpd_se"), lag.unseen, strict=True)),
            **picked(lag, "kept", "instead_of=instead", "slight"),
        },
        "causes": {
            name: {"elpd": elpd, "elpd_se": elpd_se, "kept": name in flown.asked.kept}
            for name, (elpd, elpd_se) in flown.asked.missed.items()
        },
        "tolerances": tolerance_results(card, {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}),
        "paths": [path_results(path) for path in flown.paths],
        "held_without": flown.held,
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


def tolerance_results(card: Card, units: Mapping[str, str]) -> dict[str, Any]:
    """The card's tolerances of these outputs."""
    stated = {name: t for name, t in card.tolerances.items() if name in units}
    return {name: {"value": t.value, "unit": units[name], "source": t.source} for name, t in stated.items()}


def path_results(path: SimulatedManoeuvre, units: Mapping[str, str] | None = None, *, alone: bool = False) -> Any:
    """One simulated manoeuvre; `units` of outputs (SI) for channels that the program does not know by name.

    `alone`: no other flight is beside it, so it has neither a split nor a chance to stay inside.
    """
    outputs = {}
    for name, error in path.errors.items():
        parts = [f"theil_{part}={part}" for part in ("bias", "variance", "covariance")]
        outputs[name] = {
            "unit": STANDARD_CHANNELS[name].unit if units is None else units[name],
            **picked(error, "rms", "largest"),
            **picked(error.theil, "theil", *parts),
            **picked(error, "within_tolerance=within", *([] if alone else ["probability_within=probability"])),
        }
    about = ("manoeuvre", "model", *(() if alone else ("split",)), "inside_envelope=inside")
    return picked(path, *about) | {"outputs": outputs}


def motion_results(found: Motion) -> dict[str, Any]:
    """Modes of motion for trajectories.json: plain numbers and text, SI and radians."""
    return {
        **picked(found, "airspeed", "altitude"),
        "estimates": "process noise" if found.filtered else "output error",
        "modes": [
            {
                "name": mode.name,
                "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
                "eigenvalue_sd": list(mode.sd),
                **named_pairs(mode.quantities, "value", "sd"),
            }
            for mode in found.modes
        ],
        "why_no_modes": found.why_not,
    }
