"""A proportional error of the recorded angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + alpha_scale) true."""
    return {"alpha": s["alpha"] / (1.0 + v["alpha_scale"]) - s["alpha"]}


EFFECT = Effect(
    name="alpha_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded angle of attack is too large or too small in proportion.",
    parameters=(
        Parameter(
            "alpha_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded angle of attack",
            Prior("normal", 0.0, 0.1),
            (-0.5, 1.0),
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"alpha_scale": 0.1}, {"alpha": 0.22}, {"alpha": -0.02}, "recorded 0.22 = 1.1 x 0.20, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"alpha_scale": (0.01, 0.2)},
)
