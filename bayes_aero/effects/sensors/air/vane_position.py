"""Flow-angle sensors away from the centre of gravity."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """The flow at the vane is (u, v + x r, w - x q); the angles by which that at the CG is turned from it.

    To first order alpha rises by x q/V, beta falls by x r/V. The airspeed is not corrected: its sensor may stand
    anywhere, and x q sin(alpha) is small.
    """
    x, V = v["vane_position"], s["airspeed"]
    beta = s.get("beta", xp.zeros_like(V))
    up = x * s["q"] / (V * xp.cos(beta))
    found = {"alpha": xp.arctan2(up * xp.cos(s["alpha"]), 1.0 + up * xp.sin(s["alpha"]))}
    if "beta" in s and "r" in s:
        right = -x * s["r"] / V
        found["beta"] = xp.arctan2(right * xp.cos(beta), 1.0 + right * xp.sin(beta))
    return found


EFFECT = Effect(
    name="vane_position",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The flow angles were recorded ahead of the centre of gravity (or behind it, where negative), on a nose boom "
    "for instance, and still contain what pitch and yaw rate do there.",
    parameters=(
        Parameter(
            "vane_position",
            "m",
            0.0,
            0.0,
            "distance of the flow-angle sensors ahead of the centre of gravity",
            Prior("normal", 0.0, 10.0),
            (-40.0, 40.0),
        ),
    ),
    channels=("alpha", "q", "airspeed"),
    increments=increments,
    example=Example(
        {"vane_position": 8.0},
        {"alpha": 0.0, "beta": 0.0, "q": 0.1, "r": 0.05, "airspeed": 80.0},
        {"alpha": 0.009999666686665, "beta": -0.004999958333958},
        "arctan(8 x 0.1/80) and -arctan(8 x 0.05/80), by hand",
    ),
    source="velocity of a point of a rigid body; Klein and Morelli 2006, ch. 10",
    sizes={"vane_position": (3.0, 20.0)},
)
