"""Rolling moment in symmetric flight."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cl += Cl0."""
    return {"Cl": v["Cl0"] + xp.zeros_like(s["alpha"])}


EFFECT = Effect(
    name="roll_offset",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The aircraft has a rolling moment in straight symmetric flight; ailerons with a wrong zero show one, too.",
    parameters=(
        Parameter(
            "Cl0",
            "1",
            0.0,
            0.0,
            "rolling moment of symmetric flight",
            Prior("normal", 0.0, 0.003, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=61,
        ),
    ),
    channels=("alpha",),
    increments=increments,
    example=Example({"Cl0": 0.001}, {"alpha": 0.1}, {"Cl": 0.001}, "by definition"),
    source="constant term of a Taylor series; textbook form",
    sizes={"Cl0": (0.0005, 0.01)},
)
