"""A constant error of the recorded pitch attitude."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + pitch_attitude_bias."""
    return {"theta": -v["pitch_attitude_bias"] + xp.zeros_like(s["theta"])}


EFFECT = Effect(
    name="pitch_attitude_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded pitch attitude is off by a constant.",
    parameters=(
        Parameter(
            "pitch_attitude_bias",
            "rad",
            0.0,
            0.0,
            "constant error of the recorded pitch attitude",
            Prior("normal", 0.0, 0.025),
        ),
    ),
    channels=("theta",),
    increments=increments,
    example=Example(
        {"pitch_attitude_bias": 0.02}, {"theta": 0.1}, {"theta": -0.02}, "recorded 0.10, true 0.08, by hand"
    ),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"pitch_attitude_bias": (0.002, 0.05)},
)
