"""Side force due to roll rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced_lateral


def increments(v, s, a, known):
    """CY += CYp p b/2V; length and speed as `reduced_lateral` has them."""
    return {"CY": reduced_lateral(v["CYp"] * s["p"], s["airspeed"], a)}


EFFECT = Effect(
    name="roll_rate_side_force",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Roll rate makes side force, at the fin above all.",
    parameters=(
        Parameter(
            "CYp",
            "1",
            0.0,
            0.0,
            "side force per p b/2V",
            Prior("normal", 0.0, 0.6, "our choice of width"),
            lengths=(Length.LATERAL_RATE,),
            place=53,
        ),
    ),
    channels=("p", "airspeed"),
    increments=increments,
    example=Example(
        {"CYp": 0.2}, {"p": 0.3, "airspeed": 60.0}, {"CY": 0.01}, "0.2 x 0.3 x 10/60, by hand, half span 10 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CYp": (0.15, 1.5)},
)
