"""A proportional error of the recorded altitude."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + altitude_scale) true."""
    return {"altitude": s["altitude"] / (1.0 + v["altitude_scale"]) - s["altitude"]}


EFFECT = Effect(
    name="altitude_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded altitude is too large or too small in proportion.",
    parameters=(
        Parameter(
            "altitude_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded altitude",
            Prior("normal", 0.0, 0.05),
            (-0.5, 1.0),
        ),
    ),
    channels=("altitude",),
    increments=increments,
    example=Example(
        {"altitude_scale": 0.02}, {"altitude": 5100.0}, {"altitude": -100.0}, "recorded 5100 = 1.02 x 5000, by hand"
    ),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"altitude_scale": (0.005, 0.1)},
)
