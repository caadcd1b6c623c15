"""Pitching moment of the landing flaps."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmdf flap."""
    return {"Cm": v["Cmdf"] * s["flap"]}


EFFECT = Effect(
    name="flap_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The landing flaps pitch the aircraft.",
    parameters=(
        Parameter("Cmdf", "1/rad", 0.0, 0.0, "pitching moment per flap deflection", Prior("normal", 0.0, 0.5)),
    ),
    channels=("flap",),
    increments=increments,
    example=Example({"Cmdf": -0.2}, {"flap": 0.3}, {"Cm": -0.06}, "-0.2 x 0.3, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cmdf": (0.02, 1.0)},
)
