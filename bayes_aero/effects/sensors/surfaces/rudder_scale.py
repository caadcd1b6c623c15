"""A proportional error of the recorded rudder deflection."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + rudder_scale) true."""
    return {"rudder": s["rudder"] / (1.0 + v["rudder_scale"]) - s["rudder"]}


EFFECT = Effect(
    name="rudder_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded rudder deflection is too large or too small in proportion.",
    parameters=(
        Parameter(
            "rudder_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded rudder deflection",
            Prior("normal", 0.0, 0.15),
            (-0.5, 1.0),
        ),
    ),
    channels=("rudder",),
    increments=increments,
    example=Example(
        {"rudder_scale": -0.2}, {"rudder": -0.08}, {"rudder": -0.02}, "recorded -0.08 = 0.8 x -0.10, by hand"
    ),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"rudder_scale": (0.02, 0.3)},
    axis=Axis.LATERAL,
)
