"""Directional stability of large sideslip."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cn += Cnbe3 beta^3: odd in beta, for the aircraft is symmetric."""
    return {"Cn": v["Cnbe3"] * s["beta"] * s["beta"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_cubed_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Directional stability is not linear in large sideslip.",
    parameters=(
        Parameter(
            "Cnbe3",
            "1/rad^3",
            0.0,
            0.0,
            "yawing moment per sideslip cubed",
            Prior("normal", 0.0, 5.0, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=79,
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"Cnbe3": -2.0}, {"beta": 0.1}, {"Cn": -0.002}, "-2 x (0.1)^3, by hand"),
    source="lowest odd term beyond the linear one, by symmetry; our choice of form",
    sizes={"Cnbe3": (0.2, 20.0)},
)
