"""Side force due to sideslip."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior, Sign


def increments(v, s, a, known):
    """CY += CYbe beta."""
    return {"CY": v["CYbe"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_side_force",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Sideslip to the right pushes the aircraft to the left.",
    parameters=(
        Parameter(
            "CYbe",
            "1/rad",
            0.0,
            -0.8,
            "side force per sideslip",
            Prior(
                "normal",
                -0.8,
                1.0,
                "jet transports of Nelson 1998, app. B, have some -0.7 to -1.0; the width is our choice",
            ),
            sign=Sign(-1, "beta", "sideslip to the right would pull the aircraft further to the right"),
            place=52,
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"CYbe": -0.8}, {"beta": 0.05}, {"CY": -0.04}, "-0.8 x 0.05, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CYbe": (0.06, 2.0)},
)
