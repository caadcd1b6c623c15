"""Pitching moment of the direct-lift flaps."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmdlc (left + right)/2."""
    return {"Cm": v["Cmdlc"] * 0.5 * (s["dlc_left"] + s["dlc_right"])}


EFFECT = Effect(
    name="dlc_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The direct-lift flaps pitch the aircraft.",
    parameters=(
        Parameter(
            "Cmdlc",
            "1/rad",
            0.0,
            0.0,
            "pitching moment per mean deflection of the direct-lift flaps",
            Prior("normal", 0.0, 0.5),
        ),
    ),
    channels=("dlc_left", "dlc_right"),
    increments=increments,
    example=Example(
        {"Cmdlc": -0.2}, {"dlc_left": 0.1, "dlc_right": 0.2}, {"Cm": -0.03}, "-0.2 x (0.1 + 0.2)/2, by hand"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cmdlc": (0.02, 1.0)},
    together=True,
)
