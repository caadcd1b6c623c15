"""Induced drag of the lift that is left, not of the attached lift."""

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.separation import kept_lift


def increments(v, s, a, known):
    """CD += share (CL^2 - CL_attached^2)/(e pi AR), where CL is the attached lift less what Kirchhoff's flow loses."""
    attached = known["CL_attached"]
    lost = v["CLa"] * s["alpha"] * (1.0 - kept_lift(known["X"], known["X_difference"]))
    return {"CD": v["induced_share"] * lost * (lost - 2.0 * attached) / (v["e"] * xp.pi * a.aspect_ratio)}


EFFECT = Effect(
    name="separated_induced_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Induced drag falls with the lift when the flow separates; the published model keeps that of attached flow.",
    parameters=(
        Parameter(
            "induced_share",
            "1",
            0.0,
            0.0,
            "share of the induced drag that is lost with the lift; 1: the drag is that of the lift that is left",
            Prior("normal", 0.0, 1.0),
            (-1.0, 2.0),
        ),
    ),
    uses=("CLa", "e"),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"induced_share": 1.0, "CLa": 4.0, "e": 0.8},
        {"alpha": 0.2},
        {"CD": (0.65**2 - 1.0) / (0.8 * math.pi * 7.0)},
        "X = 1/4 leaves 1 - 0.8 x 0.4375 = 0.65 of a lift of 1, by hand, aspect ratio 7",
        known={"CL_attached": 1.0, "X": 0.25},
    ),
    source="induced drag of the actual lift, CL^2/(e pi AR): the textbook polar, beyond the stall too",
    sizes={"induced_share": (0.1, 1.0)},
)
