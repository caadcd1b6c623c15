"""Lift of the direct-lift flaps."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL_attached += CLdlc (left + right)/2."""
    return {"CL_attached": v["CLdlc"] * 0.5 * (s["dlc_left"] + s["dlc_right"])}


EFFECT = Effect(
    name="dlc_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The direct-lift flaps change the lift.",
    parameters=(
        Parameter(
            "CLdlc", "1/rad", 0.0, 0.0, "lift per mean deflection of the direct-lift flaps", Prior("normal", 0.0, 1.5)
        ),
    ),
    channels=("dlc_left", "dlc_right"),
    increments=increments,
    example=Example(
        {"CLdlc": 1.2},
        {"dlc_left": -0.05, "dlc_right": -0.15},
        {"CL_attached": -0.12},
        "1.2 x (-0.05 + -0.15)/2, by hand",
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLdlc": (0.1, 3.0)},
    together=True,
)
