"""Yawing moment due to roll rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced_lateral


def increments(v, s, a, known):
    """Cn += Cnp p b/2V; length and speed as `reduced_lateral` has them."""
    return {"Cn": reduced_lateral(v["Cnp"] * s["p"], s["airspeed"], a)}


EFFECT = Effect(
    name="roll_rate_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Roll rate yaws the aircraft, for it tilts the lift of either wing.",
    parameters=(
        Parameter(
            "Cnp",
            "1",
            0.0,
            -0.1,
            "yawing moment per p b/2V",
            Prior(
                "normal",
                -0.1,
                0.2,
                "jet transports of Nelson 1998, app. B, have some -0.1 to -0.2; the width is our choice",
            ),
            lengths=(Length.LATERAL_MOMENT, Length.LATERAL_RATE),
            place=73,
        ),
    ),
    channels=("p", "airspeed"),
    increments=increments,
    example=Example(
        {"Cnp": -0.12}, {"p": 0.3, "airspeed": 60.0}, {"Cn": -0.006}, "-0.12 x 0.3 x 10/60, by hand, half span 10 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cnp": (0.025, 0.6)},
)
