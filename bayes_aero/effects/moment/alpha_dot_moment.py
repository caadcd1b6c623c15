"""Pitching moment due to the rate of the angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced


def increments(v, s, a, known):
    """Cm += Cmadot alpha_dot c/V; length and speed as `reduced` has them."""
    return {"Cm": reduced(v["Cmadot"] * s["alpha_dot"], s["airspeed"], a)}


EFFECT = Effect(
    name="alpha_dot_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="A changing angle of attack pitches the aircraft: downwash needs time to reach the tail.",
    parameters=(
        Parameter(
            "Cmadot",
            "1",
            0.0,
            0.0,
            "pitching moment due to alpha-dot, per alpha_dot c/V",
            Prior("normal", 0.0, 10.0),
            lengths=(Length.RATE,),
        ),
    ),
    channels=("alpha_dot", "airspeed"),
    increments=increments,
    example=Example(
        {"Cmadot": -4.0}, {"alpha_dot": 0.05, "airspeed": 60.0}, {"Cm": -0.01}, "-4 x 0.05 x 3/60, by hand, chord 3 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cmadot": (1.0, 20.0)},
)
