"""Directional stability that depends on the angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cn += Cnbea alpha beta."""
    return {"Cn": v["Cnbea"] * s["alpha"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_alpha_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Directional stability fades with the angle of attack, as the wake of wing and body reaches the fin.",
    parameters=(
        Parameter(
            "Cnbea",
            "1/rad^2",
            0.0,
            0.0,
            "change of directional stability per angle of attack",
            Prior("normal", 0.0, 1.0, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=78,
        ),
    ),
    channels=("alpha", "beta"),
    increments=increments,
    example=Example({"Cnbea": -0.4}, {"alpha": 0.25, "beta": 0.05}, {"Cn": -0.005}, "-0.4 x 0.25 x 0.05, by hand"),
    source="next term of a Taylor series; our choice of form",
    sizes={"Cnbea": (0.07, 3.0)},
)
