"""Drag of the stabilizer."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDih ih, signed: the trimmed tail carries load.

    The trim follows the airspeed, so in one manoeuvre it says much the same as alpha does: diagnosis never proposes it.
    """
    return {"CD": v["CDih"] * s["stabilizer"]}


EFFECT = Effect(
    name="stabilizer_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The trim of the stabilizer changes the drag.",
    parameters=(Parameter("CDih", "1/rad", 0.0, 0.0, "drag per stabilizer deflection", Prior("normal", 0.0, 0.25)),),
    channels=("stabilizer",),
    increments=increments,
    example=Example({"CDih": 0.1}, {"stabilizer": -0.05}, {"CD": -0.005}, "0.1 x -0.05, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CDih": (0.02, 0.5)},
    candidate=False,
)
