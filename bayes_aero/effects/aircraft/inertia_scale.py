"""A pitch inertia other than the card's."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """True Iy = (1 + inertia_scale) of the card's."""
    return {"Iy": v["inertia_scale"] * a.Iy}


EFFECT = Effect(
    name="inertia_scale",
    kind=Kind.MASS,
    stage=Stage.AIRCRAFT,
    claim="The pitch inertia is larger or smaller than the card says.",
    parameters=(
        Parameter(
            "inertia_scale",
            "1",
            0.0,
            0.0,
            "relative departure of Iy from the card",
            Prior("normal", 0.0, 0.15),
            (-0.5, 1.0),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example({"inertia_scale": -0.05}, {}, {"Iy": -10000.0}, "-5 % of 200000 kg m^2, by hand"),
    source="definition of a relative error",
    sizes={"inertia_scale": (0.03, 0.3)},
)
