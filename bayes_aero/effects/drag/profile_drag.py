"""Drag at zero lift in attached flow."""

from math import inf

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Limits, Parameter, Prior


def increments(v, s, a, known):
    """CD += CD0."""
    return {"CD": v["CD0"] + 0.0 * s["alpha"]}


EFFECT = Effect(
    name="profile_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The aircraft has drag at zero lift.",
    parameters=(
        Parameter(
            "CD0",
            "1",
            0.0,
            0.04,
            "zero-lift drag",
            Prior("normal", 0.04, 0.05),
            limits=Limits(0.0, inf, "drag without lift cannot be negative"),
            place=11,
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"CD0": 0.04}, {"alpha": 0.1}, {"CD": 0.04}, "by hand"),
    source="Jategaonkar 2015, ch. 12, Kirchhoff stall model",
    sizes={"CD0": (0.001, 0.2)},
)
