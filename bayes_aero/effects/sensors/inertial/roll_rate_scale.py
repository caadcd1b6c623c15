"""A proportional error of the recorded roll rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + roll_rate_scale) true."""
    return {"p": s["p"] / (1.0 + v["roll_rate_scale"]) - s["p"]}


EFFECT = Effect(
    name="roll_rate_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded roll rate is too large or too small in proportion.",
    parameters=(
        Parameter(
            "roll_rate_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded roll rate",
            Prior("normal", 0.0, 0.075),
            (-0.5, 1.0),
        ),
    ),
    channels=("p",),
    increments=increments,
    example=Example({"roll_rate_scale": 0.05}, {"p": 0.042}, {"p": -0.002}, "recorded 0.042 = 1.05 x 0.04, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"roll_rate_scale": (0.01, 0.15)},
)
