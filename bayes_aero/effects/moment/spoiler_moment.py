"""Pitching moment of the spoilers."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmds (left + right)/2."""
    return {"Cm": v["Cmds"] * 0.5 * (s["spoiler_left"] + s["spoiler_right"])}


EFFECT = Effect(
    name="spoiler_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The spoilers pitch the aircraft.",
    parameters=(
        Parameter(
            "Cmds", "1/rad", 0.0, 0.0, "pitching moment per mean deflection of the spoilers", Prior("normal", 0.0, 0.5)
        ),
    ),
    channels=("spoiler_left", "spoiler_right"),
    increments=increments,
    example=Example(
        {"Cmds": 0.3}, {"spoiler_left": 0.0, "spoiler_right": 0.2}, {"Cm": 0.03}, "0.3 x (0 + 0.2)/2, by hand"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cmds": (0.02, 1.0)},
    together=True,
)
