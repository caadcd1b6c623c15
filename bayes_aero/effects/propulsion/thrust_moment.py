"""Pitching moment of a thrust line that lies elsewhere than the card says."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += T thrust_arm/(qbar S c): a line further down pitches up."""
    qbar = 0.5 * s["density"] * xp.square(s["airspeed"])
    return {"Cm": v["thrust_arm"] * s["thrust"] / (qbar * a.wing_area * a.chord)}


EFFECT = Effect(
    name="thrust_moment",
    kind=Kind.PROPULSION,
    stage=Stage.TOTAL,
    claim="Thrust pitches the aircraft more or less than the position of the engines says.",
    parameters=(
        Parameter(
            "thrust_arm",
            "m",
            0.0,
            0.0,
            "how much lower the thrust line lies than on the card",
            Prior("normal", 0.0, 0.5),
        ),
    ),
    channels=("thrust", "density", "airspeed"),
    increments=increments,
    example=Example(
        {"thrust_arm": 0.3},
        {"thrust": 9000.0, "density": 1.0, "airspeed": 60.0},
        {"Cm": 1.0 / 120.0},
        "9000 x 0.3/(1800 x 60 x 3), by hand, 60 m^2 and chord 3 m",
    ),
    source="a force at an arm makes a moment, by mechanics",
    sizes={"thrust_arm": (0.05, 2.0)},
    together=True,
)
