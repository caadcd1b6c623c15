"""Accelerometers higher than the card says, all three."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Where they are, by which the record is brought to the centre of gravity; z is down."""
    return {"accelerometer": (0.0, 0.0, -v["accelerometer_height"])}


EFFECT = Effect(
    name="accelerometer_height",
    kind=Kind.MEASUREMENT,
    stage=Stage.AIRCRAFT,
    claim="The accelerometers are higher than the card says (or lower, where negative).",
    parameters=(
        Parameter(
            "accelerometer_height",
            "m",
            0.0,
            0.0,
            "height of the accelerometers above the place on the card",
            Prior("normal", 0.0, 1.0),
            (-20.0, 20.0),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example(
        {"accelerometer_height": 0.5}, {}, {"accelerometer": (0.0, 0.0, -0.5)}, "z is down; geometry, by hand"
    ),
    source="acceleration of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"accelerometer_height": (0.2, 3.0)},
    axis=Axis.LATERAL,
)
