"""Rolling and yawing moment of a wing whose separated flow has more drag than the other."""

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.physics.half_wings import moments_of_difference


def increments(v, s, a, known):
    """Cl, Cn of CDX (X left less right), half of it on either wing (see `moments_of_difference`)."""
    return moments_of_difference(xp.zeros_like(s["alpha"]), -v["CDX"] * known["X_difference"], s["alpha"], a)


EFFECT = Effect(
    name="wing_drag_difference",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The wing with more separated flow is dragged back.",
    parameters=(),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"CDX": 0.12},
        {"alpha": 0.2},
        {"Cl": -0.03 / (3.0 * math.pi) * math.sin(0.2), "Cn": 0.03 / (3.0 * math.pi) * math.cos(0.2)},
        "0.12 x 1/4 more drag on the right wing, at 4/(3 pi) of half a span, by hand",
        known={"X": 0.5, "X_difference": -0.25},
    ),
    source="drag of `separated_drag`, on either wing at the centroid of an elliptic distribution, by mechanics",
    uses=("CDX",),
)
