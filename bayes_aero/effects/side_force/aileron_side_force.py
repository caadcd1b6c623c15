"""Side force due to the ailerons."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CY += CYda da."""
    return {"CY": v["CYda"] * s["aileron"]}


EFFECT = Effect(
    name="aileron_side_force",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The ailerons make side force.",
    parameters=(
        Parameter(
            "CYda",
            "1/rad",
            0.0,
            0.0,
            "side force per aileron deflection, half of right less left",
            Prior("normal", 0.0, 0.15, "our choice of width"),
            place=55,
        ),
    ),
    channels=("aileron",),
    increments=increments,
    example=Example({"CYda": 0.05}, {"aileron": -0.1}, {"CY": -0.005}, "0.05 x -0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CYda": (0.04, 0.4)},
)
