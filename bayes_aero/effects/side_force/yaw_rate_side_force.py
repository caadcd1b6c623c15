"""Side force due to yaw rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced_lateral


def increments(v, s, a, known):
    """CY += CYr r b/2V; length and speed as `reduced_lateral` has them."""
    return {"CY": reduced_lateral(v["CYr"] * s["r"], s["airspeed"], a)}


EFFECT = Effect(
    name="yaw_rate_side_force",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Yaw rate makes side force, at the fin above all.",
    parameters=(
        Parameter(
            "CYr",
            "1",
            0.0,
            0.0,
            "side force per r b/2V",
            Prior("normal", 0.0, 1.0, "our choice of width"),
            lengths=(Length.LATERAL_RATE,),
            place=54,
        ),
    ),
    channels=("r", "airspeed"),
    increments=increments,
    example=Example(
        {"CYr": 0.6}, {"r": 0.1, "airspeed": 60.0}, {"CY": 0.01}, "0.6 x 0.1 x 10/60, by hand, half span 10 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CYr": (0.4, 2.0)},
)
