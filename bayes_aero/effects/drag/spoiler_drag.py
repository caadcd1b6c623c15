"""Drag of the spoilers."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDds (left + right)/2."""
    return {"CD": v["CDds"] * 0.5 * (s["spoiler_left"] + s["spoiler_right"])}


EFFECT = Effect(
    name="spoiler_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The spoilers change the drag.",
    parameters=(
        Parameter("CDds", "1/rad", 0.0, 0.0, "drag per mean deflection of the spoilers", Prior("normal", 0.0, 0.25)),
    ),
    channels=("spoiler_left", "spoiler_right"),
    increments=increments,
    example=Example(
        {"CDds": 0.2}, {"spoiler_left": 0.1, "spoiler_right": 0.3}, {"CD": 0.04}, "0.2 x (0.1 + 0.3)/2, by hand"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CDds": (0.01, 0.5)},
    together=True,
)
