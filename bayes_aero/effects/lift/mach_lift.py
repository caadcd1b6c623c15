"""Lift-curve slope that grows with Mach number."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL_attached += CLaM Mach alpha."""
    return {"CL_attached": v["CLaM"] * s["mach"] * s["alpha"]}


EFFECT = Effect(
    name="mach_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The lift-curve slope changes with Mach number.",
    parameters=(
        Parameter("CLaM", "1/rad", 0.0, 0.0, "lift-curve slope per Mach number", Prior("normal", 0.0, 15.0), place=23),
    ),
    channels=("alpha", "mach"),
    increments=increments,
    example=Example({"CLaM": 9.0}, {"alpha": 0.1, "mach": 0.3}, {"CL_attached": 0.27}, "9 x 0.3 x 0.1, by hand"),
    source="the ATTAS stall model as published with the data of Jategaonkar 2015",
    sizes={"CLaM": (0.5, 20.0)},
)
