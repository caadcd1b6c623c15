"""A constant error of the recorded roll rate."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + roll_rate_bias."""
    return {"p": -v["roll_rate_bias"] + xp.zeros_like(s["p"])}


EFFECT = Effect(
    name="roll_rate_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded roll rate is off by a constant.",
    parameters=(
        Parameter(
            "roll_rate_bias",
            "rad/s",
            0.0,
            0.0,
            "constant error of the recorded roll rate",
            Prior("normal", 0.0, 0.01),
        ),
    ),
    channels=("p",),
    increments=increments,
    example=Example({"roll_rate_bias": 0.004}, {"p": 0.054}, {"p": -0.004}, "recorded 0.054, true 0.05, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"roll_rate_bias": (0.0005, 0.02)},
)
