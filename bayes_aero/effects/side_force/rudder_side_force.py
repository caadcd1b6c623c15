"""Side force due to the rudder."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior, Sign


def increments(v, s, a, known):
    """CY += CYdr dr."""
    return {"CY": v["CYdr"] * s["rudder"]}


EFFECT = Effect(
    name="rudder_side_force",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The rudder makes side force (trailing edge left is positive, so CYdr > 0).",
    parameters=(
        Parameter(
            "CYdr",
            "1/rad",
            0.0,
            0.2,
            "side force per rudder deflection",
            Prior("normal", 0.2, 0.3, "jet transports of Nelson 1998, app. B, have some 0.18; the width is our choice"),
            sign=Sign(1, "rudder", "a positive deflection (trailing edge left) would push the fin to the left"),
            place=56,
        ),
    ),
    channels=("rudder",),
    increments=increments,
    example=Example({"CYdr": 0.2}, {"rudder": 0.1}, {"CY": 0.02}, "0.2 x 0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CYdr": (0.06, 0.8)},
)
