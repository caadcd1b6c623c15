"""Pitching moment due to roll rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmp p b/2V; odd in p, so only an asymmetry (rig, sideslip, engines) makes it."""
    return {"Cm": v["Cmp"] * s["p"] * a.half_span / s["airspeed"]}


EFFECT = Effect(
    name="roll_rate_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Rolling pitches the aircraft.",
    parameters=(
        Parameter("Cmp", "1", 0.0, 0.0, "pitching moment due to roll rate, per p b/2V", Prior("normal", 0.0, 1.5)),
    ),
    channels=("p", "airspeed"),
    increments=increments,
    example=Example(
        {"Cmp": 0.5}, {"p": 0.06, "airspeed": 60.0}, {"Cm": 0.005}, "0.5 x 0.06 x 10/60, by hand, half span 10 m"
    ),
    source="first term of a Taylor series; our choice of form",
    sizes={"Cmp": (0.2, 3.0)},
)
