"""Dihedral effect of large sideslip."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cl += Clbe3 beta^3: odd in beta, for the aircraft is symmetric."""
    return {"Cl": v["Clbe3"] * s["beta"] * s["beta"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_cubed_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The dihedral effect is not linear in large sideslip.",
    parameters=(
        Parameter(
            "Clbe3",
            "1/rad^3",
            0.0,
            0.0,
            "rolling moment per sideslip cubed",
            Prior("normal", 0.0, 5.0, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=69,
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"Clbe3": 2.0}, {"beta": 0.1}, {"Cl": 0.002}, "2 x (0.1)^3, by hand"),
    source="lowest odd term beyond the linear one, by symmetry; our choice of form",
    sizes={"Clbe3": (0.2, 20.0)},
)
