"""A sideslip sensor above the centre of gravity."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """The vane reads beta + h p/V at the height h = -z; what roll rate does there is taken out."""
    right = -v["sideslip_vane_height"] * s["p"] / s["airspeed"]
    return {"beta": xp.arctan2(right * xp.cos(s["beta"]), 1.0 + right * xp.sin(s["beta"]))}


EFFECT = Effect(
    name="sideslip_vane_height",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The sideslip was recorded above the centre of gravity (or below it, where negative), and still contains "
    "what roll rate does there.",
    parameters=(
        Parameter(
            "sideslip_vane_height",
            "m",
            0.0,
            0.0,
            "height of the sideslip sensor above the CG",
            Prior("normal", 0.0, 2.0),
            (-20.0, 20.0),
        ),
    ),
    channels=("beta", "p", "airspeed"),
    increments=increments,
    example=Example(
        {"sideslip_vane_height": 2.0},
        {"beta": 0.0, "p": 0.2, "airspeed": 80.0},
        {"beta": -0.004999958333958},
        "-arctan(2 x 0.2/80), by hand",
    ),
    source="velocity of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"sideslip_vane_height": (0.5, 10.0)},
    axis=Axis.LATERAL,
)
