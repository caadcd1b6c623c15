"""Yawing moment of one wing stalled before the other, beyond that of lift and drag."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cn += CnX (X right less left)."""
    return {"Cn": v["CnX"] * known["X_difference"]}


EFFECT = Effect(
    name="separated_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The difference of separation between the wings yaws the aircraft otherwise than their lift and drag say.",
    parameters=(
        Parameter(
            "CnX",
            "1",
            0.0,
            -0.02,
            "yawing moment of a right wing attached and a left one separated",
            Prior("normal", 0.0, 0.05, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"CnX": -0.04}, {"alpha": 0.2}, {"Cn": 0.01}, "-0.04 x -1/4, by hand", known={"X": 0.5, "X_difference": -0.25}
    ),
    source="proportional to the difference of the separation points; our choice of form",
    sizes={"CnX": (0.005, 0.3)},
)
