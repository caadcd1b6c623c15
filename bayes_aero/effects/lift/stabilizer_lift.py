"""Stabilizer lift beyond the tail lift that goes with its moment by geometry."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL_attached += CLih_extra ih.

    The trim follows the airspeed, so in one manoeuvre it says much the same as alpha does: diagnosis never proposes it.
    """
    return {"CL_attached": v["CLih_extra"] * s["stabilizer"]}


EFFECT = Effect(
    name="stabilizer_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The stabilizer makes more or less lift than its moment and the tail arm say.",
    parameters=(
        Parameter("CLih_extra", "1/rad", 0.0, 0.0, "stabilizer lift beyond -Cmih c/l_tail", Prior("normal", 0.0, 1.0)),
    ),
    channels=("stabilizer",),
    increments=increments,
    example=Example({"CLih_extra": 0.5}, {"stabilizer": -0.04}, {"CL_attached": -0.02}, "0.5 x -0.04, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLih_extra": (0.1, 3.0)},
    candidate=False,
)
