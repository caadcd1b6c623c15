"""Yawing moment due to the rudder."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior, Sign


def increments(v, s, a, known):
    """Cn += Cndr dr."""
    return {"Cn": v["Cndr"] * s["rudder"]}


EFFECT = Effect(
    name="rudder_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The rudder yaws the aircraft (trailing edge left is positive, so Cndr < 0).",
    parameters=(
        Parameter(
            "Cndr",
            "1/rad",
            0.0,
            -0.1,
            "rudder effectiveness",
            Prior(
                "normal",
                -0.1,
                0.15,
                "jet transports of Nelson 1998, app. B, have some -0.06 to -0.11; the width is our choice",
            ),
            lengths=(Length.LATERAL_MOMENT,),
            sign=Sign(-1, "rudder", "a positive deflection (trailing edge left) would turn the nose to the right"),
            place=76,
        ),
    ),
    channels=("rudder",),
    increments=increments,
    example=Example({"Cndr": -0.1}, {"rudder": 0.1}, {"Cn": -0.01}, "-0.1 x 0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cndr": (0.007, 0.4)},
)
