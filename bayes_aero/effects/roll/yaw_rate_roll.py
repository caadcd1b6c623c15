"""Rolling moment due to yaw rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced_lateral


def increments(v, s, a, known):
    """Cl += Clr r b/2V; length and speed as `reduced_lateral` has them."""
    return {"Cl": reduced_lateral(v["Clr"] * s["r"], s["airspeed"], a)}


EFFECT = Effect(
    name="yaw_rate_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Yaw rate rolls the aircraft, for the outer wing is faster.",
    parameters=(
        Parameter(
            "Clr",
            "1",
            0.0,
            0.1,
            "rolling moment per r b/2V",
            Prior("normal", 0.1, 0.3, "jet transports of Nelson 1998, app. B, have some 0.1; the width is our choice"),
            lengths=(Length.LATERAL_MOMENT, Length.LATERAL_RATE),
            place=64,
        ),
    ),
    channels=("r", "airspeed"),
    increments=increments,
    example=Example(
        {"Clr": 0.12}, {"r": 0.1, "airspeed": 60.0}, {"Cl": 0.002}, "0.12 x 0.1 x 10/60, by hand, half span 10 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Clr": (0.05, 1.0)},
)
