"""A proportional error of the recorded aileron deflection."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + aileron_scale) true."""
    return {"aileron": s["aileron"] / (1.0 + v["aileron_scale"]) - s["aileron"]}


EFFECT = Effect(
    name="aileron_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded aileron deflection is too large or too small in proportion.",
    parameters=(
        Parameter(
            "aileron_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded aileron deflection",
            Prior("normal", 0.0, 0.15),
            (-0.5, 1.0),
        ),
    ),
    channels=("aileron",),
    increments=increments,
    example=Example(
        {"aileron_scale": -0.2}, {"aileron": -0.08}, {"aileron": -0.02}, "recorded -0.08 = 0.8 x -0.10, by hand"
    ),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"aileron_scale": (0.02, 0.3)},
    axis=Axis.LATERAL,
)
