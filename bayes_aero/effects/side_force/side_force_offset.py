"""Side force in symmetric flight."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CY += CY0."""
    return {"CY": v["CY0"] + xp.zeros_like(s["alpha"])}


EFFECT = Effect(
    name="side_force_offset",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The aircraft has a side force in straight symmetric flight.",
    parameters=(
        Parameter(
            "CY0",
            "1",
            0.0,
            0.0,
            "side force of symmetric flight",
            Prior("normal", 0.0, 0.02, "our choice of width"),
            place=51,
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"CY0": 0.01}, {"alpha": 0.1}, {"CY": 0.01}, "by definition"),
    source="constant term of a Taylor series; textbook form",
    sizes={"CY0": (0.004, 0.05)},
)
