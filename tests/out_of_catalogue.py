"""Effects that are in no catalogue, to be hidden in simulated flights, and parameters that change during one."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.demo import DT, MARGIN
from bayes_aero.simulate.injection import Beyond, hidden_records


def _effect(
    name: str, channels: tuple[str, ...], neutral: dict[str, float], increments: Any, stage: Stage = Stage.TOTAL
) -> Effect:
    own = tuple(
        Parameter(key, "-", x, x, "of an effect of no catalogue", Prior("normal", 0.0, 1.0))
        for key, x in neutral.items()
    )
    return Effect(name, Kind.AERODYNAMICS, stage, name, own, channels, increments, Example({}, {}, {}, ""), "")


def _bank(v, s, *_):
    return {"Cm": v["unknown_bank"] * jnp.sin(s["phi"])}


def _periodic(v, s, *_):
    wave = jnp.sin(2.0 * jnp.pi * s["time"] / v["unknown_period"] + v["unknown_phase"])
    return {"CL": v["unknown_CL_wave"] * wave, "Cm": v["unknown_Cm_wave"] * wave}


def _bump(v, s, *_):
    away = (s["altitude"] - v["unknown_height"]) / v["unknown_width"]
    return {"CL": v["unknown_bump"] * jnp.exp(-0.5 * away**2)}


WAVE = {"unknown_CL_wave": 0.0, "unknown_Cm_wave": 0.0, "unknown_period": 5.0, "unknown_phase": 0.0}
BUMP = {"unknown_bump": 0.0, "unknown_height": 5000.0, "unknown_width": 100.0}
UNKNOWN: tuple[Effect, ...] = (
    _effect("bank_moment", ("phi",), {"unknown_bank": 0.0}, _bank),
    _effect("periodic", ("time",), WAVE, _periodic),
    _effect("altitude_bump", ("altitude",), BUMP, _bump),
)
"""Effects by name: a moment from bank angle, a wave in time, a bump of lift at one altitude."""


def unknown(name: str) -> Beyond:
    """All of `UNKNOWN`, one program for whichever is hidden; that of this name has a size drawn at random."""
    return Beyond(UNKNOWN, partial(_draw, name))


def _draw(name: str, rng: np.random.Generator) -> dict[str, float]:
    sign = rng.choice([-1.0, 1.0])
    if name == "bank_moment":
        return {"unknown_bank": sign * rng.uniform(0.02, 0.06)}
    if name == "periodic":
        target, low, high = [("CL", 0.03, 0.08), ("Cm", 0.008, 0.025)][rng.integers(2)]
        wave = {f"unknown_{target}_wave": sign * rng.uniform(low, high)}
        return wave | {"unknown_period": rng.uniform(3.0, 15.0), "unknown_phase": rng.uniform(0.0, 2.0 * np.pi)}
    assert name == "altitude_bump"
    return {
        "unknown_bump": sign * rng.uniform(0.06, 0.12),
        "unknown_height": rng.uniform(4700.0, 5000.0),
        "unknown_width": rng.uniform(60.0, 120.0),
    }


# A parameter of the aircraft takes another value halfway through the second of two manoeuvres
AT = 43.0  # s from the begin of the record


def _late(s: Any) -> Any:
    return jnp.where(s["time"] >= AT + MARGIN * DT, 1.0, 0.0)


def _lift(v, s, *_):
    return {"CL_attached": v["change_CLaM"] * s["mach"] * s["alpha"] * _late(s)}


CHANGES = (
    _effect("Cm0", ("time",), {"change_Cm0": 0.0}, lambda v, s, *_: {"Cm": v["change_Cm0"] * _late(s)}),
    _effect("CLaM", ("time", "alpha", "mach"), {"change_CLaM": 0.0}, _lift, Stage.ATTACHED),
)
"""One program for all changes; where none is hidden it is the same."""


def changed(parameter: str | None, size: float, *, seed: int, **options: Any) -> list[FlightRecord]:
    """Two records of one aircraft, whose `parameter` (Cm0, CLaM; None: none) grows by `size` after `AT` s of the second
    one. Options as of `hidden_flights`."""

    def flown(values: dict[str, float]) -> list[FlightRecord]:
        return hidden_records({}, seed=seed, beyond=Beyond(CHANGES, lambda _: values), **options)

    before = flown({})
    if parameter is None:
        return before
    return [before[0], flown({f"change_{parameter}": size})[1]]
