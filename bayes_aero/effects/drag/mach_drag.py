"""Drag that changes with Mach number."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDM Mach."""
    return {"CD": v["CDM"] * s["mach"]}


EFFECT = Effect(
    name="mach_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The drag changes with Mach number.",
    parameters=(Parameter("CDM", "1", 0.0, 0.0, "drag per Mach number", Prior("normal", 0.0, 0.15)),),
    channels=("mach",),
    increments=increments,
    example=Example({"CDM": 0.1}, {"mach": 0.3}, {"CD": 0.03}, "0.1 x 0.3, by hand"),
    source="first term of a Taylor series in Mach number; our choice of form",
    sizes={"CDM": (0.01, 0.3)},
)
