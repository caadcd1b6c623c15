"""Static stability in separated flow."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += CmaX (1 - X) alpha."""
    return {"Cm": v["CmaX"] * (1.0 - known["X"]) * s["alpha"]}


EFFECT = Effect(
    name="separated_alpha_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Static stability changes as the flow separates.",
    parameters=(
        Parameter(
            "CmaX", "1/rad", 0.0, 0.0, "change of static stability in fully separated flow", Prior("normal", 0.0, 1.0)
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example(
        {"CmaX": -0.6}, {"alpha": 0.25}, {"Cm": -0.09}, "-0.6 x (1 - 0.4) x 0.25, by hand", known={"X": 0.4}
    ),
    source="derivative linear in the separated share 1 - X; our choice of form",
    sizes={"CmaX": (0.02, 2.0)},
)
