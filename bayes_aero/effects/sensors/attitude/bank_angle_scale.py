"""A proportional error of the recorded bank angle."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + bank_angle_scale) true."""
    return {"phi": s["phi"] / (1.0 + v["bank_angle_scale"]) - s["phi"]}


EFFECT = Effect(
    name="bank_angle_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded bank angle is too large or too small in proportion.",
    parameters=(
        Parameter(
            "bank_angle_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded bank angle",
            Prior("normal", 0.0, 0.05),
            (-0.5, 1.0),
        ),
    ),
    channels=("phi",),
    increments=increments,
    example=Example({"bank_angle_scale": 0.25}, {"phi": 0.5}, {"phi": -0.1}, "recorded 0.5 = 1.25 x 0.4, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"bank_angle_scale": (0.01, 0.15)},
)
