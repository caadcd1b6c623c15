"""A lateral accelerometer higher than the card says, by itself."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.filters import differentiate_joined


def increments(v, s, a, known):
    """Recorded = true + h (p_dot - q r) at the height h = -z."""
    p_dot = differentiate_joined(s["p"], s["dt"], s["first"], s["last"])
    return {"ay": -v["accel_y_height"] * (p_dot - s["q"] * s["r"])}


EFFECT = Effect(
    name="accel_y_height",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The lateral specific force was recorded higher than the card says (or lower, where negative), and still "
    "contains what roll acceleration does there.",
    parameters=(
        Parameter(
            "accel_y_height",
            "m",
            0.0,
            0.0,
            "height of the lateral accelerometer above the place on the card",
            Prior("normal", 0.0, 1.0),
            (-20.0, 20.0),
        ),
    ),
    channels=("ay", "p", "q", "r"),
    increments=increments,
    example=Example(
        {"accel_y_height": 0.5},
        {
            "r": (0.2,) * 5,
            "p": (0.0, 0.03, 0.06, 0.09, 0.12),
            "q": (0.1,) * 5,
            "dt": (0.1,) * 5,
            "first": (0,) * 5,
            "last": (4,) * 5,
        },
        {"ay": (-0.14,) * 5},
        "-0.5 (0.3 - 0.1 x 0.2), by hand; p rises by 0.03 in 0.1 s",
    ),
    source="acceleration of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"accel_y_height": (0.2, 3.0)},
    axis=Axis.LATERAL,
)
