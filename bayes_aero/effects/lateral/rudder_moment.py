"""Pitching moment due to the rudder."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmdr |dr|: even in dr, for the aircraft is symmetric."""
    return {"Cm": v["Cmdr"] * xp.abs(s["rudder"])}


EFFECT = Effect(
    name="rudder_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Rudder deflection pitches the aircraft.",
    parameters=(
        Parameter("Cmdr", "1/rad", 0.0, 0.0, "pitching moment per rudder deflection", Prior("normal", 0.0, 0.25)),
    ),
    channels=("rudder",),
    increments=increments,
    example=Example({"Cmdr": 0.1}, {"rudder": -0.04}, {"Cm": 0.004}, "0.1 x 0.04, by hand"),
    source="even in the deflection by symmetry; our choice of form",
    sizes={"Cmdr": (0.04, 0.5)},
)
