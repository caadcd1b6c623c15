"""A roll inertia other than the card's."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """True Ix = (1 + roll_inertia_scale) of the card's."""
    return {"Ix": v["roll_inertia_scale"] * a.Ix}


EFFECT = Effect(
    name="roll_inertia_scale",
    kind=Kind.MASS,
    stage=Stage.AIRCRAFT,
    claim="The roll inertia is larger or smaller than the card says.",
    parameters=(
        Parameter(
            "roll_inertia_scale",
            "1",
            0.0,
            0.0,
            "relative departure of Ix from the card",
            Prior("normal", 0.0, 0.15),
            (-0.5, 1.0),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example({"roll_inertia_scale": -0.05}, {}, {"Ix": -5000.0}, "-5 % of 100000 kg m^2, by hand"),
    source="definition of a relative error",
    sizes={"roll_inertia_scale": (0.03, 0.3)},
    axis=Axis.LATERAL,
)
