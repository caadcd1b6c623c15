"""A proportional error of the recorded yaw rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + yaw_rate_scale) true."""
    return {"r": s["r"] / (1.0 + v["yaw_rate_scale"]) - s["r"]}


EFFECT = Effect(
    name="yaw_rate_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded yaw rate is too large or too small in proportion.",
    parameters=(
        Parameter(
            "yaw_rate_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded yaw rate",
            Prior("normal", 0.0, 0.075),
            (-0.5, 1.0),
        ),
    ),
    channels=("r",),
    increments=increments,
    example=Example({"yaw_rate_scale": 0.05}, {"r": 0.042}, {"r": -0.002}, "recorded 0.042 = 1.05 x 0.04, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"yaw_rate_scale": (0.01, 0.15)},
)
