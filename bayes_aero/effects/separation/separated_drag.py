"""Drag of separated flow."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDX (1 - X)."""
    return {"CD": v["CDX"] * (1.0 - known["X"])}


EFFECT = Effect(
    name="separated_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Separated flow adds drag.",
    parameters=(Parameter("CDX", "1", 0.0, 0.05, "drag of fully separated flow", Prior("normal", 0.1, 0.2), place=13),),
    channels=("alpha",),
    increments=increments,
    example=Example({"CDX": 0.08}, {"alpha": 0.2}, {"CD": 0.06}, "0.08 x (1 - 1/4), by hand", known={"X": 0.25}),
    source="Jategaonkar 2015, ch. 12, Kirchhoff stall model",
    sizes={"CDX": (0.003, 0.4)},
)
