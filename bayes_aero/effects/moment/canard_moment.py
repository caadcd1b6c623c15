"""Pitching moment of the canard."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmdc canard: ahead of the centre of gravity, trailing edge down pitches up."""
    return {"Cm": v["Cmdc"] * s["canard"]}


EFFECT = Effect(
    name="canard_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The canard pitches the aircraft (trailing edge down is positive, so Cmdc > 0).",
    parameters=(Parameter("Cmdc", "1/rad", 0.0, 0.0, "canard effectiveness", Prior("normal", 0.0, 1.0)),),
    channels=("canard",),
    increments=increments,
    example=Example({"Cmdc": 0.6}, {"canard": 0.1}, {"Cm": 0.06}, "0.6 x 0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cmdc": (0.03, 3.0)},
)
