"""Lift due to the rate of the angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced


def increments(v, s, a, known):
    """CL_attached += CLadot alpha_dot c/V; length and speed as `reduced` has them."""
    return {"CL_attached": reduced(v["CLadot"] * s["alpha_dot"], s["airspeed"], a)}


EFFECT = Effect(
    name="alpha_dot_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="A changing angle of attack makes lift: downwash needs time to reach the tail.",
    parameters=(
        Parameter(
            "CLadot",
            "1",
            0.0,
            0.0,
            "lift due to alpha-dot, per alpha_dot c/V",
            Prior("normal", 0.0, 10.0),
            lengths=(Length.RATE,),
        ),
    ),
    channels=("alpha_dot", "airspeed"),
    increments=increments,
    example=Example(
        {"CLadot": 2.0},
        {"alpha_dot": 0.04, "airspeed": 80.0},
        {"CL_attached": 0.003},
        "2 x 0.04 x 3/80, by hand, chord 3 m",
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLadot": (2.0, 10.0)},
)
