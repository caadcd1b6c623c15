"""Thrust that follows the computed thrust with a lag."""

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.separation import lagged


def increments(v, s, a, known):
    """thrust_lag dT/dt + T = computed thrust, in equilibrium at the start of each manoeuvre; so of either engine."""
    recorded = {name: s[name] for name in ("thrust", "thrust_left", "thrust_right") if name in s}
    tau = v["thrust_lag"] + xp.zeros_like(s["thrust"])
    return {name: lagged(T, tau, s["dt"], s["start"]) - T for name, T in recorded.items()}


EFFECT = Effect(
    name="thrust_lag",
    kind=Kind.PROPULSION,
    stage=Stage.CHANNEL,
    claim="The thrust follows what the record says with a lag.",
    parameters=(
        Parameter(
            "thrust_lag", "s", 0.0, 1.0, "time constant of the thrust", Prior("halfnormal", 0.0, 2.5), (0.0, 20.0)
        ),
    ),
    channels=("thrust",),
    increments=increments,
    example=Example(
        {"thrust_lag": 1.0},
        {"thrust": (0.0, 1000.0, 2000.0), "dt": (1.0, 1.0, 1.0), "start": (1.0, 0.0, 0.0)},
        {"thrust": (0.0, 1000.0 * (math.exp(-1.0) - 1.0), 1000.0 * (math.exp(-2.0) - 1.0))},
        "a first-order lag of 1 s behind a ramp of 1000 N/s: -1000 (1 - exp(-t)), closed form",
    ),
    source="first-order lag; our choice of form",
    sizes={"thrust_lag": (0.3, 5.0)},
    scan={"thrust_lag": (0.5, 1.0, 2.0, 4.0)},
)
