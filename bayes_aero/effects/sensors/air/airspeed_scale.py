"""A proportional error of the recorded airspeed, and of the Mach number derived from it."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Recorded = (1 + airspeed_scale) true; a Mach number that follows the airspeed likewise."""
    share = 1.0 / (1.0 + v["airspeed_scale"]) - 1.0
    off = {"airspeed": s["airspeed"] * share}
    return off | ({"mach": s["mach"] * share * s.get("mach_follows", 1.0)} if "mach" in s else {})


EFFECT = Effect(
    name="airspeed_scale",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The recorded airspeed is too large or too small in proportion.",
    parameters=(
        Parameter(
            "airspeed_scale",
            "1",
            0.0,
            0.0,
            "relative error of the recorded airspeed",
            Prior("normal", 0.0, 0.05),
            (-0.5, 1.0),
        ),
    ),
    channels=("airspeed",),
    increments=increments,
    example=Example(
        {"airspeed_scale": 0.05},
        {"airspeed": 84.0, "mach": 0.252},
        {"airspeed": -4.0, "mach": -0.012},
        "recorded 84 = 1.05 x 80; 0.252 = 1.05 x 0.24; by hand",
    ),
    source="sensor error model, Klein and Morelli 2006, ch. 10",
    sizes={"airspeed_scale": (0.005, 0.1)},
)
