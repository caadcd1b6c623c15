"""Yawing moment in symmetric flight."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cn += Cn0."""
    return {"Cn": v["Cn0"] + xp.zeros_like(s["alpha"])}


EFFECT = Effect(
    name="yaw_offset",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The aircraft has a yawing moment in straight symmetric flight.",
    parameters=(
        Parameter(
            "Cn0",
            "1",
            0.0,
            0.0,
            "yawing moment of symmetric flight",
            Prior("normal", 0.0, 0.003, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=71,
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"Cn0": -0.001}, {"alpha": 0.1}, {"Cn": -0.001}, "by definition"),
    source="constant term of a Taylor series; textbook form",
    sizes={"Cn0": (0.0005, 0.01)},
)
