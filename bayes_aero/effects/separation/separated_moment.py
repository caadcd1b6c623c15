"""Pitching moment of separated flow."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += CmX (1 - X)."""
    return {"Cm": v["CmX"] * (1.0 - known["X"])}


EFFECT = Effect(
    name="separated_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Separated flow pitches the aircraft.",
    parameters=(
        Parameter(
            "CmX", "1", 0.0, -0.1, "pitching moment of fully separated flow", Prior("normal", -0.1, 0.3), place=35
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"CmX": -0.12}, {"alpha": 0.2}, {"Cm": -0.09}, "-0.12 x (1 - 1/4), by hand", known={"X": 0.25}),
    source="Jategaonkar 2015, ch. 12, Kirchhoff stall model",
    sizes={"CmX": (0.005, 0.5)},
)
