"""Lift of the canard."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL_attached += CLdc canard."""
    return {"CL_attached": v["CLdc"] * s["canard"]}


EFFECT = Effect(
    name="canard_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The canard changes the lift.",
    parameters=(Parameter("CLdc", "1/rad", 0.0, 0.0, "lift per canard deflection", Prior("normal", 0.0, 0.5)),),
    channels=("canard",),
    increments=increments,
    example=Example({"CLdc": 0.4}, {"canard": 0.1}, {"CL_attached": 0.04}, "0.4 x 0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLdc": (0.1, 2.0)},
)
