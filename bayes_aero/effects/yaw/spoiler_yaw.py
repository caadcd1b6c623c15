"""Yawing moment of spoilers that differ left and right."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cn += Cnds (right - left)/2."""
    return {"Cn": v["Cnds"] * 0.5 * (s["spoiler_right"] - s["spoiler_left"])}


EFFECT = Effect(
    name="spoiler_yaw",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Spoilers of one side yaw the aircraft to that side.",
    parameters=(
        Parameter(
            "Cnds",
            "1/rad",
            0.0,
            0.0,
            "yawing moment per half of right less left spoiler",
            Prior("normal", 0.0, 0.05, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=77,
        ),
    ),
    channels=("spoiler_left", "spoiler_right"),
    increments=increments,
    example=Example(
        {"Cnds": 0.02}, {"spoiler_left": 0.1, "spoiler_right": 0.0}, {"Cn": -0.001}, "0.02 x (0 - 0.1)/2, by hand"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cnds": (0.003, 0.15)},
    together=True,
)
