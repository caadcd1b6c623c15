"""A constant error of the recorded longitudinal specific force."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + accel_x_bias."""
    return {"ax": -v["accel_x_bias"] + xp.zeros_like(s["ax"])}


EFFECT = Effect(
    name="accel_x_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded longitudinal specific force is off by a constant.",
    parameters=(
        Parameter(
            "accel_x_bias",
            "m/s^2",
            0.0,
            0.0,
            "constant error of the recorded longitudinal specific force",
            Prior("normal", 0.0, 0.25),
        ),
    ),
    channels=("ax",),
    increments=increments,
    example=Example({"accel_x_bias": 0.05}, {"ax": 1.25}, {"ax": -0.05}, "recorded 1.25, true 1.20, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"accel_x_bias": (0.01, 0.5)},
)
