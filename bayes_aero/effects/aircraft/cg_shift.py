"""A centre of gravity further forward than the card's."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Positions are measured from the CG: with it dx further forward, all else lies dx further aft."""
    dx = v["cg_shift"]
    aft = (-dx, 0.0, 0.0)
    return {"reference_point": aft, "accelerometer": aft, "engine": aft, "tail_arm": dx}


EFFECT = Effect(
    name="cg_shift",
    kind=Kind.MASS,
    stage=Stage.AIRCRAFT,
    claim="The centre of gravity lies further forward or aft than the card says.",
    parameters=(
        Parameter(
            "cg_shift", "m", 0.0, 0.0, "CG forward of the card's position", Prior("normal", 0.0, 0.25), (-2.0, 2.0)
        ),
    ),
    channels=(),
    increments=increments,
    example=Example(
        {"cg_shift": 0.1},
        {},
        {
            "reference_point": (-0.1, 0.0, 0.0),
            "accelerometer": (-0.1, 0.0, 0.0),
            "engine": (-0.1, 0.0, 0.0),
            "tail_arm": 0.1,
        },
        "geometry, by hand",
    ),
    source="geometry",
    sizes={"cg_shift": (0.03, 0.5)},
)
