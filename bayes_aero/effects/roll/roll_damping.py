"""Roll damping."""

from math import inf

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Limits, Parameter, Prior
from bayes_aero.physics.rates import reduced_lateral


def increments(v, s, a, known):
    """Cl += Clp p b/2V; length and speed as `reduced_lateral` has them."""
    return {"Cl": reduced_lateral(v["Clp"] * s["p"], s["airspeed"], a)}


EFFECT = Effect(
    name="roll_damping",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Roll rate is damped by a rolling moment.",
    parameters=(
        Parameter(
            "Clp",
            "1",
            0.0,
            -0.4,
            "roll damping, per p b/2V",
            Prior(
                "normal",
                -0.4,
                0.4,
                "jet transports of Nelson 1998, app. B, have some -0.4 to -0.5; the width is our choice",
            ),
            lengths=(Length.LATERAL_MOMENT, Length.LATERAL_RATE),
            limits=Limits(-inf, 0.0, "roll rate would not be damped in attached flow"),
            place=63,
        ),
    ),
    channels=("p", "airspeed"),
    increments=increments,
    example=Example(
        {"Clp": -0.4}, {"p": 0.3, "airspeed": 60.0}, {"Cl": -0.02}, "-0.4 x 0.3 x 10/60, by hand, half span 10 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Clp": (0.025, 1.5)},
)
