"""Rolling moment due to sideslip: the dihedral effect."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior, Sign


def increments(v, s, a, known):
    """Cl += Clbe beta."""
    return {"Cl": v["Clbe"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="Sideslip to the right rolls the aircraft to the left (dihedral effect).",
    parameters=(
        Parameter(
            "Clbe",
            "1/rad",
            0.0,
            -0.1,
            "dihedral effect, rolling moment per sideslip",
            Prior(
                "normal",
                -0.1,
                0.2,
                "jet transports of Nelson 1998, app. B, have some -0.1 to -0.2; the width is our choice",
            ),
            lengths=(Length.LATERAL_MOMENT,),
            sign=Sign(-1, "beta", "sideslip to the right would roll the aircraft to the right"),
            place=62,
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"Clbe": -0.1}, {"beta": 0.05}, {"Cl": -0.005}, "-0.1 x 0.05, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Clbe": (0.007, 0.5)},
)
