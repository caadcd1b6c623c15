"""Engines of which one delivers more than recorded and the other less."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """True left and right thrust = recorded + and - thrust_asymmetry times their mean: the total stays."""
    more = v["thrust_asymmetry"] * 0.5 * (s["thrust_left"] + s["thrust_right"])
    return {"thrust_left": more, "thrust_right": -more}


EFFECT = Effect(
    name="thrust_asymmetry",
    kind=Kind.PROPULSION,
    stage=Stage.CHANNEL,
    claim="The left engine delivers more thrust than recorded and the right one less (or reversed, where negative).",
    parameters=(
        Parameter(
            "thrust_asymmetry",
            "1",
            0.0,
            0.0,
            "share by which the left engine delivers more",
            Prior("normal", 0.0, 0.1, "our choice of width"),
            (-1.0, 1.0),
        ),
    ),
    channels=("thrust_left", "thrust_right"),
    increments=increments,
    example=Example(
        {"thrust_asymmetry": 0.05},
        {"thrust_left": 5000.0, "thrust_right": 7000.0},
        {"thrust_left": 300.0, "thrust_right": -300.0},
        "5 % of 6000 N, by hand",
    ),
    source="definition of a relative error",
    sizes={"thrust_asymmetry": (0.01, 0.5)},
    axis=Axis.LATERAL,
)
