"""A sideslip sensor ahead of the centre of gravity."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """The vane reads beta + x r/V; what yaw rate does there is taken out."""
    right = -v["sideslip_vane_position"] * s["r"] / s["airspeed"]
    return {"beta": xp.arctan2(right * xp.cos(s["beta"]), 1.0 + right * xp.sin(s["beta"]))}


EFFECT = Effect(
    name="sideslip_vane_position",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The sideslip was recorded ahead of the centre of gravity (or behind it, where negative), and still contains "
    "what yaw rate does there.",
    parameters=(
        Parameter(
            "sideslip_vane_position",
            "m",
            0.0,
            0.0,
            "distance of the sideslip sensor ahead of the CG, beyond vane_position",
            Prior("normal", 0.0, 10.0),
            (-40.0, 40.0),
        ),
    ),
    channels=("beta", "r", "airspeed"),
    increments=increments,
    example=Example(
        {"sideslip_vane_position": 8.0},
        {"beta": 0.0, "r": 0.05, "airspeed": 80.0},
        {"beta": -0.004999958333958},
        "-arctan(8 x 0.05/80), by hand",
    ),
    source="velocity of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"sideslip_vane_position": (1.0, 20.0)},
    axis=Axis.LATERAL,
)
