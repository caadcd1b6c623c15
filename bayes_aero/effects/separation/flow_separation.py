"""Trailing-edge flow separation: the separation point X leaves 1 as the angle of attack passes alpha*."""

import math

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior, Role
from bayes_aero.physics.separation import separation_point

ATTACHED = 10.0  # rad; so far above any angle of attack that X is 1 to the last bit


def increments(v, s, a, known):
    """X = (1 - tanh(a1 (incidence - alpha*)))/2."""
    return {"X": separation_point(v["a1"], known["incidence"], v["alpha_star"]) - 1.0}


EFFECT = Effect(
    name="flow_separation",
    kind=Kind.AERODYNAMICS,
    stage=Stage.SEPARATION,
    claim="The flow separates from the trailing edge as the angle of attack approaches the break point.",
    parameters=(
        Parameter(
            "a1",
            "1/rad",
            20.0,
            20.0,
            "abruptness of the stall",
            Prior(
                "lognormal",
                20.0,
                0.7,
                "a factor of four either way with 95 %; our choice",
            ),
            (1.0, 200.0),
            role=Role.ABRUPTNESS,
            place=41,
        ),
        Parameter(
            "alpha_star",
            "rad",
            ATTACHED,
            0.3,
            "angle of attack at which X = 1/2",
            Prior("normal", 0.3, 0.1, "stall of a transport between 10 and 25 deg; our choice"),
            (0.0, 1.0),
            role=Role.BREAK_ANGLE,
            place=42,
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"a1": 20.0, "alpha_star": 0.3},
        {"alpha": 0.32},
        {"X": (1.0 - math.tanh(0.4)) / 2.0 - 1.0},
        "the definition of X, by hand",
    ),
    source="Goman and Khrabrov 1994; Fischenberg and Jategaonkar 1999",
    sizes={"a1": (2.0, 80.0), "alpha_star": (ATTACHED - 0.5, ATTACHED - 0.1)},  # alpha* from 10 rad to 0.5 or 0.1 rad
    scan={"alpha_star": (0.2, 0.25, 0.3, 0.35)},
)
