"""Lift of the landing flaps."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL_attached += CLdf flap: lift of the attached flow, so that induced drag goes with it."""
    return {"CL_attached": v["CLdf"] * s["flap"]}


EFFECT = Effect(
    name="flap_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The landing flaps change the lift.",
    parameters=(Parameter("CLdf", "1/rad", 0.0, 0.0, "lift per flap deflection", Prior("normal", 0.0, 1.5)),),
    channels=("flap",),
    increments=increments,
    example=Example({"CLdf": 0.9}, {"flap": 0.2}, {"CL_attached": 0.18}, "0.9 x 0.2, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLdf": (0.05, 3.0)},
)
