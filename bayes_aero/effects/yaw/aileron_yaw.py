"""Yawing moment due to the ailerons: adverse yaw."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cn += Cnda da."""
    return {"Cn": v["Cnda"] * s["aileron"]}


EFFECT = Effect(
    name="aileron_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The ailerons yaw the aircraft (where Cnda > 0, away from the turn: adverse yaw).",
    parameters=(
        Parameter(
            "Cnda",
            "1/rad",
            0.0,
            0.0,
            "yawing moment per aileron deflection, half of right less left",
            Prior("normal", 0.0, 0.05, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=75,
        ),
    ),
    channels=("aileron",),
    increments=increments,
    example=Example({"Cnda": 0.01}, {"aileron": 0.1}, {"Cn": 0.001}, "0.01 x 0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cnda": (0.005, 0.15)},
)
