"""Rolling moment due to the rudder."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cl += Cldr dr."""
    return {"Cl": v["Cldr"] * s["rudder"]}


EFFECT = Effect(
    name="rudder_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The rudder rolls the aircraft, for the fin lies above the roll axis.",
    parameters=(
        Parameter(
            "Cldr",
            "1/rad",
            0.0,
            0.0,
            "rolling moment per rudder deflection",
            Prior("normal", 0.0, 0.05, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=66,
        ),
    ),
    channels=("rudder",),
    increments=increments,
    example=Example({"Cldr": 0.02}, {"rudder": -0.1}, {"Cl": -0.002}, "0.02 x -0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Cldr": (0.007, 0.15)},
)
