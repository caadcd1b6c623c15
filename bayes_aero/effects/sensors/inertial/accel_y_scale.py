"""A proportional error of the recorded lateral specific force."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + accel_y_scale) true."""
    return {"ay": s["ay"] / (1.0 + v["accel_y_scale"]) - s["ay"]}


EFFECT = Effect(
    name="accel_y_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded lateral specific force is too large or too small in proportion.",
    parameters=(
        Parameter(
            "accel_y_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded lateral specific force",
            Prior("normal", 0.0, 0.1),
            (-0.5, 1.0),
        ),
    ),
    channels=("ay",),
    increments=increments,
    example=Example({"accel_y_scale": 0.25}, {"ay": 0.5}, {"ay": -0.1}, "recorded 0.5 = 1.25 x 0.4, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"accel_y_scale": (0.02, 0.3)},
)
