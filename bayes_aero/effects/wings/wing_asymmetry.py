"""A wing that stalls first."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """incidence_difference += wing_asymmetry."""
    return {"incidence_difference": v["wing_asymmetry"] + xp.zeros_like(s["alpha"])}


EFFECT = Effect(
    name="wing_asymmetry",
    kind=Kind.AERODYNAMICS,
    stage=Stage.INCIDENCE,
    claim="One wing stalls at a smaller angle of attack than the other (the right one first where positive).",
    parameters=(
        Parameter(
            "wing_asymmetry",
            "rad",
            0.0,
            0.0,
            "angle by which the right wing stalls before the left",
            Prior("normal", 0.0, 0.0175, "one degree; our choice of width"),
            (-0.2, 0.2),
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"wing_asymmetry": 0.01}, {"alpha": 0.2}, {"incidence_difference": 0.01}, "by definition"),
    source="a difference of twist, or of the stall angles of the two wings, by definition",
    sizes={"wing_asymmetry": (0.003, 0.06)},
)
