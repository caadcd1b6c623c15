"""Rolling moment of one wing stalled before the other, beyond that of the lift lost."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cl += ClX (X right less left)."""
    return {"Cl": v["ClX"] * known["X_difference"]}


EFFECT = Effect(
    name="separated_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The difference of separation between the wings rolls the aircraft otherwise than the lift lost says.",
    parameters=(
        Parameter(
            "ClX",
            "1",
            0.0,
            -0.05,
            "rolling moment of a right wing attached and a left one separated",
            Prior("normal", 0.0, 0.1, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"ClX": -0.08}, {"alpha": 0.2}, {"Cl": -0.02}, "-0.08 x 1/4, by hand", known={"X": 0.5, "X_difference": 0.25}
    ),
    source="proportional to the difference of the separation points; our choice of form",
    sizes={"ClX": (0.005, 0.5)},
)
