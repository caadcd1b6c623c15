"""Rolling and yawing moment of a wing that has lost more lift than the other."""

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.physics.half_wings import moments_of_difference
from bayes_aero.physics.separation import kirchhoff_factor


def increments(v, s, a, known):
    """Cl, Cn of CLa alpha ((1 + sqrt X)/2)^2, right less left, half of it on either wing: `moments_of_difference`."""
    half = known["X_difference"] / 2.0
    difference = kirchhoff_factor(known["X"] + half) - kirchhoff_factor(known["X"] - half)
    return moments_of_difference(v["CLa"] * s["alpha"] * difference, xp.zeros_like(half), s["alpha"], a)


EFFECT = Effect(
    name="wing_lift_difference",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The wing with more separated flow drops.",
    parameters=(),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"CLa": 4.0},
        {"alpha": 0.2},
        {"Cl": 0.35 / (3.0 * math.pi) * math.cos(0.2), "Cn": 0.35 / (3.0 * math.pi) * math.sin(0.2)},
        "X = 1/4 right, 1 left: right 9/16 of the lift, so 0.8 x -7/16 at 4/(3 pi) of half a span, by hand",
        known={"X": 0.625, "X_difference": -0.75},
    ),
    source="lift of `kirchhoff_lift`, on either wing at the centroid of an elliptic distribution, by mechanics",
    uses=("CLa",),
)
