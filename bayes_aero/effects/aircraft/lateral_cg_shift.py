"""A centre of gravity further right than the card's."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Positions are measured from the CG: with it dy further right, all else lies dy further left."""
    left = (0.0, -v["lateral_cg_shift"], 0.0)
    return {"reference_point": left, "accelerometer": left, "engine": left}


EFFECT = Effect(
    name="lateral_cg_shift",
    kind=Kind.MASS,
    stage=Stage.AIRCRAFT,
    claim="The centre of gravity lies further right or left than the card says, by an asymmetry of fuel for instance.",
    parameters=(
        Parameter(
            "lateral_cg_shift",
            "m",
            0.0,
            0.0,
            "CG right of the card's position",
            Prior("normal", 0.0, 0.1, "our choice of width"),
            (-2.0, 2.0),
        ),
    ),
    channels=(),
    increments=increments,
    example=Example(
        {"lateral_cg_shift": 0.1},
        {},
        {"reference_point": (0.0, -0.1, 0.0), "accelerometer": (0.0, -0.1, 0.0), "engine": (0.0, -0.1, 0.0)},
        "geometry, by hand",
    ),
    source="geometry",
    sizes={"lateral_cg_shift": (0.02, 0.5)},
    axis=Axis.LATERAL,
)
