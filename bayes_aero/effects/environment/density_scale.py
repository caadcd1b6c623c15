"""Air denser or thinner than the record says."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + density_scale) true."""
    return {"density": s["density"] / (1.0 + v["density_scale"]) - s["density"]}


EFFECT = Effect(
    name="density_scale",
    kind=Kind.ENVIRONMENT,
    stage=Stage.CHANNEL,
    claim="The air is denser or thinner than the record says.",
    parameters=(
        Parameter(
            "density_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded air density",
            Prior("normal", 0.0, 0.05),
            (-0.5, 1.0),
        ),
    ),
    channels=("density",),
    increments=increments,
    example=Example(
        {"density_scale": 0.04}, {"density": 0.78}, {"density": -0.03}, "recorded 0.78 = 1.04 x 0.75, by hand"
    ),
    source="definition of a relative error",
    sizes={"density_scale": (0.01, 0.1)},
)
