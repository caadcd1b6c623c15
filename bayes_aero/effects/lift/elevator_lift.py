"""Elevator lift beyond the tail lift that goes with its moment by geometry."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL_attached += CLde_extra de."""
    return {"CL_attached": v["CLde_extra"] * s["elevator"]}


EFFECT = Effect(
    name="elevator_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The elevator makes more or less lift than its moment and the tail arm say.",
    parameters=(
        Parameter("CLde_extra", "1/rad", 0.0, 0.0, "elevator lift beyond -Cmde c/l_tail", Prior("normal", 0.0, 0.5)),
    ),
    channels=("elevator",),
    increments=increments,
    example=Example({"CLde_extra": 0.3}, {"elevator": -0.1}, {"CL_attached": -0.03}, "0.3 x -0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLde_extra": (0.1, 1.0)},
)
