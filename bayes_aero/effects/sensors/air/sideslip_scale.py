"""A proportional error of the recorded sideslip."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + sideslip_scale) true."""
    return {"beta": s["beta"] / (1.0 + v["sideslip_scale"]) - s["beta"]}


EFFECT = Effect(
    name="sideslip_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded sideslip is too large or too small in proportion.",
    parameters=(
        Parameter(
            "sideslip_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded sideslip",
            Prior("normal", 0.0, 0.1),
            (-0.5, 1.0),
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"sideslip_scale": 0.1}, {"beta": 0.22}, {"beta": -0.02}, "recorded 0.22 = 1.1 x 0.2, by hand"),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"sideslip_scale": (0.02, 0.2)},
)
