"""Effects that are in no catalogue, to be hidden in simulated flights."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.injection import Beyond


def _effect(name: str, channels: tuple[str, ...], parameters: tuple[tuple[str, float], ...], increments: Any) -> Effect:
    own = tuple(
        Parameter(key, "-", neutral, neutral, "of an effect of no catalogue", Prior("normal", 0.0, 1.0))
        for key, neutral in parameters
    )
    return Effect(name, Kind.AERODYNAMICS, Stage.TOTAL, name, own, channels, increments, Example({}, {}, {}, ""), "")


def _periodic(v, s, *_):
    wave = jnp.sin(2.0 * jnp.pi * s["time"] / v["unknown_period"] + v["unknown_phase"])
    return {"CL": v["unknown_CL_wave"] * wave, "Cm": v["unknown_Cm_wave"] * wave}


UNKNOWN: tuple[Effect, ...] = (
    _effect(
        "bank_moment",
        ("phi",),
        (("unknown_bank", 0.0),),
        lambda v, s, *_: {"Cm": v["unknown_bank"] * jnp.sin(s["phi"])},
    ),
    _effect(
        "periodic",
        ("time",),
        (("unknown_CL_wave", 0.0), ("unknown_Cm_wave", 0.0), ("unknown_period", 5.0), ("unknown_phase", 0.0)),
        _periodic,
    ),
    _effect(
        "altitude_bump",
        ("altitude",),
        (("unknown_bump", 0.0), ("unknown_height", 5000.0), ("unknown_width", 100.0)),
        lambda v, s, *_: {
            "CL": v["unknown_bump"] * jnp.exp(-0.5 * ((s["altitude"] - v["unknown_height"]) / v["unknown_width"]) ** 2)
        },
    ),
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
