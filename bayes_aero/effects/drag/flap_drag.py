"""Drag of the landing flaps beyond the induced drag of their lift."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDdf flap."""
    return {"CD": v["CDdf"] * s["flap"]}


EFFECT = Effect(
    name="flap_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The landing flaps change the drag.",
    parameters=(Parameter("CDdf", "1/rad", 0.0, 0.0, "drag per flap deflection", Prior("normal", 0.0, 0.25)),),
    channels=("flap",),
    increments=increments,
    example=Example({"CDdf": 0.15}, {"flap": 0.2}, {"CD": 0.03}, "0.15 x 0.2, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CDdf": (0.01, 0.5)},
)
