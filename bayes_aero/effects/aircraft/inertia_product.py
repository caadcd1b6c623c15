"""A product of inertia other than the card's."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """True Ixz = the card's + inertia_product Iz."""
    return {"Ixz": v["inertia_product"] * a.Iz}


EFFECT = Effect(
    name="inertia_product",
    kind=Kind.MASS,
    stage=Stage.AIRCRAFT,
    claim="The principal axes of inertia are inclined otherwise than the card says, and so couple roll and yaw.",
    parameters=(
        Parameter(
            "inertia_product",
            "1",
            0.0,
            0.0,
            "departure of Ixz from the card, share of Iz",
            Prior("normal", 0.0, 0.03, "our choice of width"),
            (-0.3, 0.3),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example({"inertia_product": 0.02}, {}, {"Ixz": 6000.0}, "2 % of 300000 kg m^2, by hand"),
    source="definition of a relative error",
    sizes={"inertia_product": (0.005, 0.1)},
    axis=Axis.LATERAL,
)
