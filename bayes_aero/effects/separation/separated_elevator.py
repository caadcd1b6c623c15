"""Elevator effectiveness in separated flow."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += CmdeX (1 - X) de."""
    return {"Cm": v["CmdeX"] * (1.0 - known["X"]) * s["elevator"]}


EFFECT = Effect(
    name="separated_elevator",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The elevator loses or gains effectiveness in the wake of separated flow.",
    parameters=(
        Parameter(
            "CmdeX",
            "1/rad",
            0.0,
            0.0,
            "change of elevator effectiveness in fully separated flow",
            Prior("normal", 0.0, 1.0),
        ),
    ),
    channels=("elevator",),
    increments=increments,
    example=Example(
        {"CmdeX": 0.4}, {"elevator": -0.1}, {"Cm": -0.03}, "0.4 x (1 - 1/4) x -0.1, by hand", known={"X": 0.25}
    ),
    source="derivative linear in the separated share 1 - X; our choice of form",
    sizes={"CmdeX": (0.07, 2.0)},
)
