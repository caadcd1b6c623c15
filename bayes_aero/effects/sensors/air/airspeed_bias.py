"""A constant error of the recorded airspeed, and of the Mach number derived from it."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = true + airspeed_bias; a Mach number that follows the airspeed is off in proportion."""
    V = s["airspeed"]
    off = -v["airspeed_bias"] + xp.zeros_like(V)
    return {"airspeed": off} | ({"mach": s["mach"] * off / V * s.get("mach_follows", 1.0)} if "mach" in s else {})


EFFECT = Effect(
    name="airspeed_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded airspeed is off by a constant.",
    parameters=(
        Parameter(
            "airspeed_bias",
            "m/s",
            0.0,
            0.0,
            "constant error of the recorded airspeed",
            Prior("normal", 0.0, 4.0),
            (-30.0, 30.0),
        ),
    ),
    channels=("airspeed",),
    increments=increments,
    example=Example(
        {"airspeed_bias": 2.0},
        {"airspeed": 80.0, "mach": 0.24},
        {"airspeed": -2.0, "mach": -0.006},
        "recorded 80, true 78; 0.24 x 2/80; by hand",
    ),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"airspeed_bias": (0.5, 8.0)},
)
