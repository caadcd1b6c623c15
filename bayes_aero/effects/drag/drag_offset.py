"""Minimum drag at a lift other than zero."""

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += (CLmin^2 - 2 CL_attached CLmin)/(e pi AR), so that the polar becomes (CL_attached - CLmin)^2/(e pi AR)."""
    CLmin = v["CLmin"]
    return {"CD": CLmin * (CLmin - 2.0 * known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)}


EFFECT = Effect(
    name="drag_offset",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Drag is least at a lift other than zero: the wing is cambered.",
    parameters=(Parameter("CLmin", "1", 0.0, 0.0, "lift at least drag", Prior("normal", 0.0, 0.25)),),
    uses=("e",),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"CLmin": 0.2, "e": 0.8},
        {"alpha": 0.1},
        {"CD": -0.36 / (0.8 * math.pi * 7.0)},
        "0.2^2 - 2 x 1 x 0.2 = -0.36, by hand, aspect ratio 7",
        known={"CL_attached": 1.0},
    ),
    source="quadratic polar of a cambered wing; textbook form",
    sizes={"CLmin": (0.02, 0.5)},
)
