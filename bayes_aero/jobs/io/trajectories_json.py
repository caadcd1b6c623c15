"""The part of diagnosis.json that tells of simulated trajectories, and the way back from it and histories.nc."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_aero.diagnosis.selection.backward_elimination import Confirmation
from bayes_aero.diagnosis.selection.residuals import TheilParts
from bayes_aero.diagnosis.trajectories.results import Error, Estimates, LagTest, Path, Trajectories
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.jobs.io.time_histories import Histories, column, flight_of

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


def open_loop(path: Path, units: Mapping[str, str] | None = None) -> dict[str, Any]:
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


def trajectories_of(told: Mapping[str, Any], histories: Histories, card: Card) -> Trajectories:
    """The inverse of `trajectory_results`, with the flights themselves from histories.nc.

    Raises KeyError, TypeError or ValueError where something is not as it was written.
    """
    parameters = told["parameters"]
    units = {name: p["unit"] for name, p in parameters.items()}

    def estimates(model: str, held: tuple[str, ...]) -> Estimates:
        values = {
            name: number(p[model]) for name, p in parameters.items() if model == "extended" or p[model] is not None
        }
        status, at_bound = OutputErrorStatus[told["status"][model]], tuple(told["at_bound"][model])
        return Estimates(values, {name: units[name] for name in values}, status, at_bound, held)

    paths = tuple(_path(one, histories, card) for one in told["paths"])
    return Trajectories(
        paths=paths,
        card=estimates("card", ()),
        extended=estimates("extended", tuple(name for name, p in parameters.items() if p["held_by_prior"])),
        deviation={name: number(p["sd"]) for name, p in parameters.items()},
        variance_inflation=number(told["variance_inflation"]),
        held={name: tuple(held) for name, held in told["held_without"].items()},
        fitted=tuple(told["fitted_outputs"]),
        outputs=tuple(paths[0].errors),
        noise_growth={name: number(x) for name, x in told["noise_growth"].items()},
        lag=None if told["lag"] is None else _lag_of(told["lag"]),
        asked=_asked_of(told["causes"]),
    )


def _asked_of(told: Mapping[str, Any]) -> Confirmation:
    missed = {name: (number(one["elpd"]), number(one["elpd_se"])) for name, one in told.items()}
    return Confirmation(tuple(name for name, one in told.items() if one["kept"]), missed)


def _lag(lag: LagTest) -> dict[str, Any]:
    elpd, elpd_se = lag.unseen
    unseen = {"elpd": elpd, "elpd_se": elpd_se}
    told = {"effect": lag.effect, "gain": lag.gain, "hold_out": unseen, "kept": lag.kept}
    return told | {"instead_of": list(lag.instead), "slight": lag.slight}


def _lag_of(told: Mapping[str, Any]) -> LagTest:
    unseen = number(told["hold_out"]["elpd"]), number(told["hold_out"]["elpd_se"])
    instead, slight = tuple(told["instead_of"]), bool(told["slight"])
    return LagTest(told["effect"], number(told["gain"]), bool(told["kept"]), unseen, instead, slight)


def _path(told: Mapping[str, Any], histories: Histories, card: Card) -> Path:
    manoeuvre, model, split = told["manoeuvre"], told["model"], told["split"]
    flight = flight_of(histories[f"trajectories_{split}"], manoeuvre)
    errors = {}
    for name, e in told["outputs"].items():
        theil = TheilParts(*(number(e[key]) for key in ("theil", *(f"theil_{part}" for part in PARTS))))
        band = card.tolerances[name].value if name in card.tolerances else None
        within, chance = e["within_tolerance"], e["probability_within"]
        errors[name] = Error(number(e["rms"]), number(e["largest"]), theil, band, within, chance)
    measured, simulated = ({name: flight[column(name, kind)] for name in errors} for kind in ("measured", model))
    return Path(manoeuvre, model, split, bool(told["inside_envelope"]), errors, flight["time"], measured, simulated)


def number(x: float | None) -> float:
    """What JSON has null for does not exist."""
    return float("nan") if x is None else float(x)
