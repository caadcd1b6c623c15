"""Drag linear in the angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDa alpha: the tangent of the drag polar at a trim point.

    Where induced drag is in the model it says the same once more, so diagnosis never proposes it.
    """
    return {"CD": v["CDa"] * s["alpha"]}


EFFECT = Effect(
    name="alpha_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Drag grows linearly with the angle of attack.",
    parameters=(Parameter("CDa", "1/rad", 0.0, 0.0, "drag per angle of attack", Prior("normal", 0.0, 1.0)),),
    channels=("alpha",),
    increments=increments,
    example=Example({"CDa": 0.3}, {"alpha": 0.1}, {"CD": 0.03}, "0.3 x 0.1, by hand"),
    source="Jategaonkar 2015, longitudinal model of the HFB 320",
    sizes={"CDa": (0.0125, 1.0)},
    candidate=False,
)
