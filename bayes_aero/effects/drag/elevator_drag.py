"""Drag of the elevator."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDde de, signed: the trimmed tail carries load, so the slope at de = 0 is not zero."""
    return {"CD": v["CDde"] * s["elevator"]}


EFFECT = Effect(
    name="elevator_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Elevator deflection changes the drag.",
    parameters=(Parameter("CDde", "1/rad", 0.0, 0.0, "drag per elevator deflection", Prior("normal", 0.0, 0.15)),),
    channels=("elevator",),
    increments=increments,
    example=Example({"CDde": 0.05}, {"elevator": -0.12}, {"CD": -0.006}, "0.05 x -0.12, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CDde": (0.02, 0.3)},
)
