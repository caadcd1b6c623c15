"""A mass other than the card's."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """True mass = (1 + mass_scale) of the card's; the inertias stay."""
    return {"mass": v["mass_scale"] * a.mass}


EFFECT = Effect(
    name="mass_scale",
    kind=Kind.MASS,
    stage=Stage.AIRCRAFT,
    claim="The aircraft is heavier or lighter than the card says.",
    parameters=(
        Parameter(
            "mass_scale",
            "1",
            0.0,
            0.0,
            "relative departure of the mass from the card",
            Prior("normal", 0.0, 0.075),
            (-0.5, 1.0),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example({"mass_scale": 0.04}, {}, {"mass": 600.0}, "4 % of 15000 kg, by hand"),
    source="definition of a relative error",
    sizes={"mass_scale": (0.01, 0.15)},
)
