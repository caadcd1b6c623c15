"""Pitch damping in separated flow."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced


def increments(v, s, a, known):
    """Cm += CmqX (1 - X) q c/V; length and speed as `reduced` has them."""
    return {"Cm": reduced(v["CmqX"] * (1.0 - known["X"]) * s["q"], s["airspeed"], a)}


EFFECT = Effect(
    name="separated_damping",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Pitch damping changes as the flow separates.",
    parameters=(
        Parameter(
            "CmqX",
            "1",
            0.0,
            0.0,
            "change of pitch damping in fully separated flow, per q c/V",
            Prior("normal", 0.0, 20.0),
            lengths=(Length.RATE,),
        ),
    ),
    channels=("q", "airspeed"),
    increments=increments,
    example=Example(
        {"CmqX": 8.0},
        {"q": 0.1, "airspeed": 60.0},
        {"Cm": 0.01},
        "8 x (1 - 3/4) x 0.1 x 3/60, by hand, chord 3 m",
        known={"X": 0.75},
    ),
    source="derivative linear in the separated share 1 - X; our choice of form",
    sizes={"CmqX": (2.0, 40.0)},
)
