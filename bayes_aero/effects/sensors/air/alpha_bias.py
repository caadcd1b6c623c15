"""A constant error of the recorded angle of attack."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + alpha_bias."""
    return {"alpha": -v["alpha_bias"] + xp.zeros_like(s["alpha"])}


EFFECT = Effect(
    name="alpha_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded angle of attack is off by a constant.",
    parameters=(
        Parameter(
            "alpha_bias", "rad", 0.0, 0.0, "constant error of the recorded angle of attack", Prior("normal", 0.0, 0.017)
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"alpha_bias": 0.01}, {"alpha": 0.21}, {"alpha": -0.01}, "recorded 0.21, true 0.20, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"alpha_bias": (0.002, 0.035)},
)
