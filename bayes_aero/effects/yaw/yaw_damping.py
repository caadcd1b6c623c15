"""Yaw damping."""

from math import inf

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Limits, Parameter, Prior
from bayes_aero.physics.rates import reduced_lateral


def increments(v, s, a, known):
    """Cn += Cnr r b/2V; length and speed as `reduced_lateral` has them."""
    return {"Cn": reduced_lateral(v["Cnr"] * s["r"], s["airspeed"], a)}


EFFECT = Effect(
    name="yaw_damping",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Yaw rate is damped by a yawing moment.",
    parameters=(
        Parameter(
            "Cnr",
            "1",
            0.0,
            -0.2,
            "yaw damping, per r b/2V",
            Prior(
                "normal",
                -0.2,
                0.3,
                "jet transports of Nelson 1998, app. B, have some -0.16 to -0.3; the width is our choice",
            ),
            lengths=(Length.LATERAL_MOMENT, Length.LATERAL_RATE),
            limits=Limits(-inf, 0.0, "yaw rate would not be damped"),
            place=74,
        ),
    ),
    channels=("r", "airspeed"),
    increments=increments,
    example=Example(
        {"Cnr": -0.24}, {"r": 0.1, "airspeed": 60.0}, {"Cn": -0.004}, "-0.24 x 0.1 x 10/60, by hand, half span 10 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cnr": (0.05, 1.2)},
)
