"""Rolling moment of spoilers that differ left and right."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cl += Clds (right - left)/2."""
    return {"Cl": v["Clds"] * 0.5 * (s["spoiler_right"] - s["spoiler_left"])}


EFFECT = Effect(
    name="spoiler_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Spoilers of one side roll the aircraft to that side.",
    parameters=(
        Parameter(
            "Clds",
            "1/rad",
            0.0,
            0.0,
            "rolling moment per half of right less left spoiler",
            Prior("normal", 0.0, 0.1, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=67,
        ),
    ),
    channels=("spoiler_left", "spoiler_right"),
    increments=increments,
    example=Example(
        {"Clds": 0.1}, {"spoiler_left": 0.0, "spoiler_right": 0.2}, {"Cl": 0.01}, "0.1 x (0.2 - 0)/2, by hand"
    ),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Clds": (0.003, 0.3)},
    together=True,
)
