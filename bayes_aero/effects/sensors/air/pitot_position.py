"""A pitot tube away from the centre of gravity."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """The flow at the tube is (u, v + x r, w - x q): its speed is recorded, and that at the CG is true.

    Exact where the flow angles are recorded at the tube, too; of angles at the CG to first order in x q/V.
    """
    x, V, alpha = v["pitot_position"], s["airspeed"], s["alpha"]
    beta = s.get("beta", xp.zeros_like(V))
    r = s.get("r", xp.zeros_like(V))
    right, down = -x * r, x * s["q"]
    # Difference of the squares, so that nothing is lost to rounding.
    more = 2.0 * V * (xp.sin(beta) * right + xp.cos(beta) * xp.sin(alpha) * down) + right**2 + down**2
    return {"airspeed": more / (xp.sqrt(V**2 + more) + V)}


EFFECT = Effect(
    name="pitot_position",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The airspeed was recorded ahead of the centre of gravity (or behind it, where negative), and still contains "
    "what pitch and yaw rate do there.",
    parameters=(
        Parameter(
            "pitot_position",
            "m",
            0.0,
            0.0,
            "distance of the pitot tube ahead of the centre of gravity",
            Prior("normal", 0.0, 10.0),
            (-40.0, 40.0),
        ),
    ),
    channels=("airspeed", "alpha", "q"),
    increments=increments,
    example=Example(
        {"pitot_position": 8.0},
        {"alpha": 0.0, "beta": 0.0, "q": 0.1, "r": 0.05, "airspeed": 80.0},
        {"airspeed": 0.004999843759765},
        "sqrt(80^2 + (8 x 0.05)^2 + (8 x 0.1)^2) - 80, by hand",
    ),
    source="velocity of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"pitot_position": (3.0, 20.0)},
    candidate=False,
)
