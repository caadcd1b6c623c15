"""Attached-flow lift, linear in the angle of attack."""

from math import inf, pi

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Limits, Parameter, Prior, Sign


def increments(v, s, a, known):
    """CL_attached = CL0 + CLa alpha."""
    return {"CL_attached": v["CL0"] + v["CLa"] * s["alpha"]}


EFFECT = Effect(
    name="attached_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Lift grows linearly with the angle of attack while the flow is attached.",
    parameters=(
        Parameter("CL0", "1", 0.0, 0.2, "lift at zero angle of attack", Prior("normal", 0.2, 0.5), place=21),
        Parameter(
            "CLa",
            "1/rad",
            0.0,
            4.5,
            "attached lift-curve slope",
            Prior("normal", 4.5, 2.0, "2 pi AR/(AR + 2) for AR of 5 to 10; width our choice"),
            sign=Sign(1, "az or alpha", "lift would decrease with the angle of attack"),
            limits=Limits(-inf, 4.0 * pi, "it is more than twice the value of a thin aerofoil of infinite span, 2 pi"),
            place=22,
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"CL0": 0.2, "CLa": 4.0}, {"alpha": 0.1}, {"CL_attached": 0.6}, "0.2 + 4.0 x 0.1, by hand"),
    source="Jategaonkar 2015, ch. 12, Kirchhoff stall model",
    sizes={"CL0": (0.01, 1.0), "CLa": (0.1, 8.0)},
)
