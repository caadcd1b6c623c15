"""Static pitching moment, linear in the angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cm0 + Cma alpha."""
    return {"Cm": v["Cm0"] + v["Cma"] * s["alpha"]}


EFFECT = Effect(
    name="pitching_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The aircraft has a static pitching moment that changes linearly with the angle of attack.",
    parameters=(
        Parameter(
            "Cm0", "1", 0.0, 0.05, "pitching moment at zero angle of attack", Prior("normal", 0.0, 0.2), place=31
        ),
        Parameter("Cma", "1/rad", 0.0, -0.5, "static stability", Prior("normal", -0.5, 1.0), place=32),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"Cm0": 0.05, "Cma": -0.5}, {"alpha": 0.2}, {"Cm": -0.05}, "0.05 - 0.5 x 0.2, by hand"),
    source="Jategaonkar 2015, ch. 12, Kirchhoff stall model",
    sizes={"Cm0": (0.002, 0.3), "Cma": (0.02, 3.0)},
)
