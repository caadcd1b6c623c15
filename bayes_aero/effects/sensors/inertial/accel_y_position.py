"""A lateral accelerometer further ahead than the card says, by itself."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.filters import differentiate_joined


def increments(v, s, a, known):
    """Recorded = true + x (r_dot + p q)."""
    r_dot = differentiate_joined(s["r"], s["dt"], s["first"], s["last"])
    return {"ay": -v["accel_y_position"] * (r_dot + s["p"] * s["q"])}


EFFECT = Effect(
    name="accel_y_position",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The lateral specific force was recorded ahead of where the card says (or behind it, where negative), and "
    "still contains what yaw acceleration does there.",
    parameters=(
        Parameter(
            "accel_y_position",
            "m",
            0.0,
            0.0,
            "distance of the lateral accelerometer ahead of the place on the card",
            Prior("normal", 0.0, 2.0),
            (-20.0, 20.0),
        ),
    ),
    channels=("ay", "p", "q", "r"),
    increments=increments,
    example=Example(
        {"accel_y_position": 2.0},
        {
            "p": (0.2,) * 5,
            "r": (0.0, 0.03, 0.06, 0.09, 0.12),
            "q": (0.1,) * 5,
            "dt": (0.1,) * 5,
            "first": (0,) * 5,
            "last": (4,) * 5,
        },
        {"ay": (-0.64,) * 5},
        "-2 (0.3 + 0.2 x 0.1), by hand; r rises by 0.03 in 0.1 s",
    ),
    source="acceleration of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"accel_y_position": (0.3, 5.0)},
    axis=Axis.LATERAL,
)
