"""Lift lost to trailing-edge separation."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.physics.separation import kept_lift


def increments(v, s, a, known):
    """CL += CLa alpha (((1 + sqrt X)/2)^2 - 1), the mean of two wings, on the Mach-independent slope as published."""
    return {"CL": v["CLa"] * s["alpha"] * (kept_lift(known["X"], known["X_difference"]) - 1.0)}


EFFECT = Effect(
    name="kirchhoff_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Separated flow loses lift as Kirchhoff's flow past a plate does.",
    parameters=(),
    uses=("CLa",),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"CLa": 4.0},
        {"alpha": 0.2},
        {"CL": 4.0 * 0.2 * (0.5625 - 1.0)},
        "X = 1/4, by hand",
        known={"X": 0.25},
    ),
    source="Kirchhoff's theory of free streamlines; Fischenberg and Jategaonkar 1999",
)
