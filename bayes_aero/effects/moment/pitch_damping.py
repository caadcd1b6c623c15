"""Pitch damping."""

from math import inf

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Limits, Parameter, Prior
from bayes_aero.physics.rates import reduced


def increments(v, s, a, known):
    """Cm += Cmq q c/V (not q c/2V, so Cmq is half of what many texts print); length and speed as `reduced` has them."""
    return {"Cm": reduced(v["Cmq"] * s["q"], s["airspeed"], a)}


EFFECT = Effect(
    name="pitch_damping",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Pitch rate is damped by a pitching moment.",
    parameters=(
        Parameter(
            "Cmq",
            "1",
            0.0,
            -8.0,
            "pitch damping, per q c/V",
            Prior("normal", -8.0, 10.0),
            lengths=(Length.RATE,),
            limits=Limits(-inf, 0.0, "pitch rate would not be damped"),
            place=33,
        ),
    ),
    channels=("q", "airspeed"),
    increments=increments,
    example=Example({"Cmq": -6.0}, {"q": 0.1, "airspeed": 60.0}, {"Cm": -0.03}, "by hand, chord 3 m"),
    source="the ATTAS stall model as published with the data of Jategaonkar 2015 (qhat = q c/V)",
    sizes={"Cmq": (1.0, 30.0)},
)
