"""Lift due to pitch rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced


def increments(v, s, a, known):
    """CL_attached += CLq q c/V (not q c/2V); length and speed as `reduced` has them."""
    return {"CL_attached": reduced(v["CLq"] * s["q"], s["airspeed"], a)}


EFFECT = Effect(
    name="pitch_rate_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Pitch rate makes lift, mostly at the tail.",
    parameters=(
        Parameter(
            "CLq",
            "1",
            0.0,
            0.0,
            "lift due to pitch rate, per q c/V",
            Prior("normal", 0.0, 10.0),
            lengths=(Length.RATE,),
        ),
    ),
    channels=("q", "airspeed"),
    increments=increments,
    example=Example(
        {"CLq": 4.0}, {"q": 0.05, "airspeed": 75.0}, {"CL_attached": 0.008}, "4 x 0.05 x 3/75, by hand, chord 3 m"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLq": (2.0, 10.0)},
)
