"""A constant error of the recorded pitch rate."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + pitch_rate_bias."""
    return {"q": -v["pitch_rate_bias"] + xp.zeros_like(s["q"])}


EFFECT = Effect(
    name="pitch_rate_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded pitch rate is off by a constant.",
    parameters=(
        Parameter(
            "pitch_rate_bias",
            "rad/s",
            0.0,
            0.0,
            "constant error of the recorded pitch rate",
            Prior("normal", 0.0, 0.01),
        ),
    ),
    channels=("q",),
    increments=increments,
    example=Example({"pitch_rate_bias": 0.004}, {"q": 0.054}, {"q": -0.004}, "recorded 0.054, true 0.050, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"pitch_rate_bias": (0.0005, 0.02)},
)
