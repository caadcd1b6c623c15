"""Thrust that is larger or smaller than computed, in proportion."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """True thrust = (1 + thrust_scale) computed thrust, of the left and the right engine too where recorded."""
    return {name: v["thrust_scale"] * s[name] for name in ("thrust", "thrust_left", "thrust_right") if name in s}


EFFECT = Effect(
    name="thrust_scale",
    kind=Kind.PROPULSION,
    stage=Stage.CHANNEL,
    claim="The engines deliver more or less thrust than the record says.",
    parameters=(
        Parameter(
            "thrust_scale",
            "1",
            0.0,
            0.0,
            "relative error of the computed thrust",
            Prior("normal", 0.0, 0.15),
            (-0.9, 2.0),
        ),
    ),
    channels=("thrust",),
    increments=increments,
    example=Example({"thrust_scale": -0.1}, {"thrust": 12000.0}, {"thrust": -1200.0}, "-10 % of 12000 N, by hand"),
    source="definition of a relative error",
    sizes={"thrust_scale": (0.02, 0.3)},
)
