"""Pitching moment that changes with Mach number."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += CmM Mach."""
    return {"Cm": v["CmM"] * s["mach"]}


EFFECT = Effect(
    name="mach_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The pitching moment changes with Mach number.",
    parameters=(Parameter("CmM", "1", 0.0, 0.0, "pitching moment per Mach number", Prior("normal", 0.0, 0.25)),),
    channels=("mach",),
    increments=increments,
    example=Example({"CmM": 0.2}, {"mach": 0.25}, {"Cm": 0.05}, "0.2 x 0.25, by hand"),
    source="first term of a Taylor series in Mach number; our choice of form",
    sizes={"CmM": (0.02, 0.5)},
)
