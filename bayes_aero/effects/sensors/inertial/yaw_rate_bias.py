"""A constant error of the recorded yaw rate."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + yaw_rate_bias."""
    return {"r": -v["yaw_rate_bias"] + xp.zeros_like(s["r"])}


EFFECT = Effect(
    name="yaw_rate_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded yaw rate is off by a constant.",
    parameters=(
        Parameter(
            "yaw_rate_bias",
            "rad/s",
            0.0,
            0.0,
            "constant error of the recorded yaw rate",
            Prior("normal", 0.0, 0.01),
        ),
    ),
    channels=("r",),
    increments=increments,
    example=Example({"yaw_rate_bias": 0.004}, {"r": 0.054}, {"r": -0.004}, "recorded 0.054, true 0.05, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"yaw_rate_bias": (0.0005, 0.02)},
)
