"""A constant error of the recorded sideslip."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + sideslip_bias."""
    return {"beta": -v["sideslip_bias"] + xp.zeros_like(s["beta"])}


EFFECT = Effect(
    name="sideslip_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded sideslip is off by a constant.",
    parameters=(
        Parameter(
            "sideslip_bias",
            "rad",
            0.0,
            0.0,
            "constant error of the recorded sideslip",
            Prior("normal", 0.0, 0.0175),
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"sideslip_bias": 0.01}, {"beta": 0.03}, {"beta": -0.01}, "recorded 0.03, true 0.02, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"sideslip_bias": (0.002, 0.035)},
)
