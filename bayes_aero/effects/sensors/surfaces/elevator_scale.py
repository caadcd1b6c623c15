"""A proportional error of the recorded elevator deflection."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + elevator_scale) true."""
    return {"elevator": s["elevator"] / (1.0 + v["elevator_scale"]) - s["elevator"]}


EFFECT = Effect(
    name="elevator_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded elevator deflection is too large or too small in proportion.",
    parameters=(
        Parameter(
            "elevator_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded elevator deflection",
            Prior("normal", 0.0, 0.15),
            (-0.5, 1.0),
        ),
    ),
    channels=("elevator",),
    increments=increments,
    example=Example(
        {"elevator_scale": -0.2}, {"elevator": -0.08}, {"elevator": -0.02}, "recorded -0.08 = 0.8 x -0.10, by hand"
    ),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"elevator_scale": (0.02, 0.3)},
)
