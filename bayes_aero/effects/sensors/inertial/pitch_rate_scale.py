"""A proportional error of the recorded pitch rate."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + pitch_rate_scale) true."""
    return {"q": s["q"] / (1.0 + v["pitch_rate_scale"]) - s["q"]}


EFFECT = Effect(
    name="pitch_rate_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded pitch rate is too large or too small in proportion.",
    parameters=(
        Parameter(
            "pitch_rate_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded pitch rate",
            Prior("normal", 0.0, 0.075),
            (-0.5, 1.0),
        ),
    ),
    channels=("q",),
    increments=increments,
    example=Example({"pitch_rate_scale": 0.05}, {"q": 0.042}, {"q": -0.002}, "recorded 0.042 = 1.05 x 0.040, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"pitch_rate_scale": (0.01, 0.15)},
)
