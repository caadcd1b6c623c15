"""A yaw inertia other than the card's."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """True Iz = (1 + yaw_inertia_scale) of the card's."""
    return {"Iz": v["yaw_inertia_scale"] * a.Iz}


EFFECT = Effect(
    name="yaw_inertia_scale",
    kind=Kind.MASS,
    stage=Stage.AIRCRAFT,
    claim="The yaw inertia is larger or smaller than the card says.",
    parameters=(
        Parameter(
            "yaw_inertia_scale",
            "1",
            0.0,
            0.0,
            "relative departure of Iz from the card",
            Prior("normal", 0.0, 0.15),
            (-0.5, 1.0),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example({"yaw_inertia_scale": -0.05}, {}, {"Iz": -15000.0}, "-5 % of 300000 kg m^2, by hand"),
    source="definition of a relative error",
    sizes={"yaw_inertia_scale": (0.03, 0.3)},
    axis=Axis.LATERAL,
)
