"""A constant error of the recorded bank angle."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + bank_angle_bias."""
    return {"phi": -v["bank_angle_bias"] + xp.zeros_like(s["phi"])}


EFFECT = Effect(
    name="bank_angle_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded bank angle is off by a constant.",
    parameters=(
        Parameter(
            "bank_angle_bias",
            "rad",
            0.0,
            0.0,
            "constant error of the recorded bank angle",
            Prior("normal", 0.0, 0.025),
        ),
    ),
    channels=("phi",),
    increments=increments,
    example=Example({"bank_angle_bias": 0.02}, {"phi": 0.5}, {"phi": -0.02}, "recorded 0.5, true 0.48, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"bank_angle_bias": (0.002, 0.05)},
)
