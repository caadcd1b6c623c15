"""Yawing moment due to sideslip: directional stability."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior, Sign


def increments(v, s, a, known):
    """Cn += Cnbe beta."""
    return {"Cn": v["Cnbe"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Sideslip turns the nose into the wind (directional stability).",
    parameters=(
        Parameter(
            "Cnbe",
            "1/rad",
            0.0,
            0.14,
            "directional stability, yawing moment per sideslip",
            Prior(
                "normal",
                0.14,
                0.2,
                "jet transports of Nelson 1998, app. B, have some 0.14 to 0.15; the width is our choice",
            ),
            lengths=(Length.LATERAL_MOMENT,),
            sign=Sign(1, "beta", "sideslip would turn the nose away from the wind"),
            place=72,
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"Cnbe": 0.14}, {"beta": 0.05}, {"Cn": 0.007}, "0.14 x 0.05, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cnbe": (0.007, 0.5)},
)
