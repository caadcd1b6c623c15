"""Accelerometers further ahead than the card says, all three."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Where they are, by which the record is brought to the centre of gravity."""
    return {"accelerometer": (v["accelerometer_position"], 0.0, 0.0)}


EFFECT = Effect(
    name="accelerometer_position",
    kind=Kind.MEASUREMENT,
    stage=Stage.AIRCRAFT,
    claim="The accelerometers are ahead of where the card says (or behind it, where negative).",
    parameters=(
        Parameter(
            "accelerometer_position",
            "m",
            0.0,
            0.0,
            "distance of the accelerometers ahead of the place on the card",
            Prior("normal", 0.0, 2.0),
            (-20.0, 20.0),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example(
        {"accelerometer_position": 0.5}, {}, {"accelerometer": (0.5, 0.0, 0.0)}, "x is forward; geometry, by hand"
    ),
    source="acceleration of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"accelerometer_position": (0.3, 5.0)},
    axis=Axis.LATERAL,
)
