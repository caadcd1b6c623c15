"""Pitching moment due to yaw rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmr r b/2V; odd in r, so only an asymmetry (rig, sideslip, engines) makes it."""
    return {"Cm": v["Cmr"] * s["r"] * a.half_span / s["airspeed"]}


EFFECT = Effect(
    name="yaw_rate_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Yawing pitches the aircraft.",
    parameters=(
        Parameter("Cmr", "1", 0.0, 0.0, "pitching moment due to yaw rate, per r b/2V", Prior("normal", 0.0, 2.5)),
    ),
    channels=("r", "airspeed"),
    increments=increments,
    example=Example(
        {"Cmr": -0.8}, {"r": 0.05, "airspeed": 80.0}, {"Cm": -0.005}, "-0.8 x 0.05 x 10/80, by hand, half span 10 m"
    ),
    source="first term of a Taylor series; our choice of form",
    sizes={"Cmr": (0.4, 5.0)},
)
