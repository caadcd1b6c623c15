"""A constant error of the recorded lateral specific force."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + accel_y_bias."""
    return {"ay": -v["accel_y_bias"] + xp.zeros_like(s["ay"])}


EFFECT = Effect(
    name="accel_y_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded lateral specific force is off by a constant.",
    parameters=(
        Parameter(
            "accel_y_bias",
            "m/s^2",
            0.0,
            0.0,
            "constant error of the recorded lateral specific force",
            Prior("normal", 0.0, 0.25),
        ),
    ),
    channels=("ay",),
    increments=increments,
    example=Example({"accel_y_bias": 0.1}, {"ay": 0.4}, {"ay": -0.1}, "recorded 0.4, true 0.3, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"accel_y_bias": (0.02, 0.5)},
)
