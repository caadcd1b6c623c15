"""Drag of the canard."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDdc canard, signed: the trimmed canard carries load, so the slope at zero deflection is not zero."""
    return {"CD": v["CDdc"] * s["canard"]}


EFFECT = Effect(
    name="canard_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Canard deflection changes the drag.",
    parameters=(Parameter("CDdc", "1/rad", 0.0, 0.0, "drag per canard deflection", Prior("normal", 0.0, 0.15)),),
    channels=("canard",),
    increments=increments,
    example=Example({"CDdc": 0.05}, {"canard": 0.2}, {"CD": 0.01}, "0.05 x 0.2, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CDdc": (0.02, 0.3)},
)
