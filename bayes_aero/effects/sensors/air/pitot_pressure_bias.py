"""A constant error of the impact pressure (total less static) from which the airspeed is computed."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior

SLOWEST = 1.0  # m/s: no pitot tube measures less
MOST = 0.99  # share of the recorded impact pressure that the error may be


def increments(v, s, a, known):
    """rho/2 recorded^2 = rho/2 true^2 + pitot_pressure_bias; a Mach number that follows the airspeed likewise."""
    V = s["airspeed"]
    impact = 0.5 * s["density"] * xp.maximum(V, SLOWEST) ** 2
    share = xp.minimum(v["pitot_pressure_bias"] / impact, MOST)
    off = -share / (1.0 + xp.sqrt(1.0 - share))
    return {"airspeed": V * off} | ({"mach": s["mach"] * off * s.get("mach_follows", 1.0)} if "mach" in s else {})


EFFECT = Effect(
    name="pitot_pressure_bias",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The pressure of the pitot or the static line is off by a constant, so the airspeed is off by the more the "
    "slower the flight.",
    parameters=(
        Parameter(
            "pitot_pressure_bias",
            "Pa",
            0.0,
            0.0,
            "constant error of the impact pressure (total less static)",
            Prior("normal", 0.0, 250.0),
            (-3000.0, 3000.0),
        ),
    ),
    channels=("airspeed", "density"),
    increments=increments,
    example=Example(
        {"pitot_pressure_bias": 59.625},
        {"airspeed": 80.0, "density": 0.75, "mach": 0.24},
        {"airspeed": -1.0, "mach": -0.003},
        "recorded 0.75/2 x 80^2 = 2400 Pa, true 0.75/2 x 79^2 = 2340.375 Pa; 0.24/80; by hand",
    ),
    source="incompressible impact pressure; errors of pitot-static systems, Gracey, NASA RP-1046, 1980",
    sizes={"pitot_pressure_bias": (30.0, 1000.0)},
)
