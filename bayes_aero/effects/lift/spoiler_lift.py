"""Lift of the spoilers."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL += CLds (left + right)/2."""
    return {"CL": v["CLds"] * 0.5 * (s["spoiler_left"] + s["spoiler_right"])}


EFFECT = Effect(
    name="spoiler_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The spoilers change the lift.",
    parameters=(
        Parameter("CLds", "1/rad", 0.0, 0.0, "lift per mean deflection of the spoilers", Prior("normal", 0.0, 1.0)),
    ),
    channels=("spoiler_left", "spoiler_right"),
    increments=increments,
    example=Example(
        {"CLds": -0.8}, {"spoiler_left": 0.1, "spoiler_right": 0.2}, {"CL": -0.12}, "-0.8 x (0.1 + 0.2)/2, by hand"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"CLds": (0.05, 2.0)},
    together=True,
)
