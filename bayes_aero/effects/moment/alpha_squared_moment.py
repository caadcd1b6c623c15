"""Pitching moment that bends with the angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cma2 alpha^2."""
    return {"Cm": v["Cma2"] * s["alpha"] * s["alpha"]}


EFFECT = Effect(
    name="alpha_squared_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The pitching moment is curved over the angle of attack.",
    parameters=(
        Parameter(
            "Cma2", "1/rad^2", 0.0, 0.0, "pitching moment per squared angle of attack", Prior("normal", 0.0, 5.0)
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"Cma2": -1.5}, {"alpha": 0.2}, {"Cm": -0.06}, "-1.5 x 0.2^2, by hand"),
    source="second term of a Taylor series; our choice of form",
    sizes={"Cma2": (0.3, 10.0)},
)
