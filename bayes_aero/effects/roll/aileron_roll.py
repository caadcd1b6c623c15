"""Rolling moment due to the ailerons."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior, Sign


def increments(v, s, a, known):
    """Cl += Clda da."""
    return {"Cl": v["Clda"] * s["aileron"]}


EFFECT = Effect(
    name="aileron_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The ailerons roll the aircraft (right one down is positive, so Clda < 0).",
    parameters=(
        Parameter(
            "Clda",
            "1/rad",
            0.0,
            -0.1,
            "aileron effectiveness, per half of right less left",
            Prior("normal", -0.1, 0.2, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            sign=Sign(-1, "aileron", "a positive deflection (right aileron down) would roll the aircraft to the right"),
            place=65,
        ),
    ),
    channels=("aileron",),
    increments=increments,
    example=Example({"Clda": -0.12}, {"aileron": 0.1}, {"Cl": -0.012}, "-0.12 x 0.1, by hand"),
    source="a linear aerodynamic derivative; textbook form",
    sizes={"Clda": (0.005, 0.6)},
)
