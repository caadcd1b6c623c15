"""A constant error of the recorded normal specific force."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + accel_z_bias."""
    return {"az": -v["accel_z_bias"] + xp.zeros_like(s["az"])}


EFFECT = Effect(
    name="accel_z_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded normal specific force is off by a constant.",
    parameters=(
        Parameter(
            "accel_z_bias",
            "m/s^2",
            0.0,
            0.0,
            "constant error of the recorded normal specific force",
            Prior("normal", 0.0, 0.5),
        ),
    ),
    channels=("az",),
    increments=increments,
    example=Example({"accel_z_bias": -0.2}, {"az": -9.9}, {"az": 0.2}, "recorded -9.9, true -9.7, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"accel_z_bias": (0.08, 1.0)},
)
