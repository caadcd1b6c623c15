"""Induced drag of the attached lift."""

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Limits, Parameter, Prior


def increments(v, s, a, known):
    """CD += CL_attached^2/(e pi AR): the published model squares the attached lift, not the Kirchhoff lift."""
    return {"CD": xp.square(known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)}


EFFECT = Effect(
    name="induced_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Drag grows with the square of the lift.",
    parameters=(
        Parameter(
            "e",
            "1",
            math.inf,
            0.8,
            "Oswald efficiency factor",
            Prior(
                "lognormal",
                0.8,
                0.5,
                "around 0.8 for a transport; our choice",
            ),
            (0.05, 10.0),
            limits=Limits(0.0, 1.5, "no wing has so little induced drag"),
            place=12,
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"e": 0.8},
        {"alpha": 0.1},
        {"CD": 1.0 / (0.8 * math.pi * 7.0)},
        "by hand, aspect ratio 7",
        known={"CL_attached": 1.0},
    ),
    source="Jategaonkar 2015, ch. 12, Kirchhoff stall model",
    sizes={"e": (0.02, 3.0)},  # of 1/e, which is 0 where e is neutral; CD is linear in it
    scan={"e": (0.8,)},
)
