"""The elevator: pitching moment, and the tail lift that goes with it by geometry."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior, Sign


def increments(v, s, a, known):
    """Cm += Cmde de; CL_attached += CLde de with CLde = -Cmde c/l_tail (force at the tail arm makes the moment)."""
    CLde = -v["Cmde"] * a.chord / a.tail_arm
    return {"Cm": v["Cmde"] * s["elevator"], "CL_attached": CLde * s["elevator"]}


EFFECT = Effect(
    name="elevator_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The elevator pitches the aircraft (trailing edge down is positive, so Cmde < 0).",
    parameters=(
        Parameter(
            "Cmde",
            "1/rad",
            0.0,
            -0.8,
            "elevator effectiveness",
            Prior("normal", -0.8, 1.0),
            sign=Sign(-1, "elevator", "a positive deflection (trailing edge down) would pitch the nose up"),
            place=34,
        ),
    ),
    channels=("elevator",),
    increments=increments,
    example=Example(
        {"Cmde": -0.5},
        {"elevator": 0.1},
        {"Cm": -0.05, "CL_attached": 0.05 * 3.0 / 15.0},
        "by hand, chord 3 m and tail arm 15 m",
    ),
    source="the ATTAS stall model as published with the data of Jategaonkar 2015",
    sizes={"Cmde": (0.03, 3.0)},
)
