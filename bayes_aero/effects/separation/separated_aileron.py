"""Aileron effectiveness in separated flow."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cl += CldaX (1 - X) da."""
    return {"Cl": v["CldaX"] * (1.0 - known["X"]) * s["aileron"]}


EFFECT = Effect(
    name="separated_aileron",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The ailerons lose effectiveness as the flow separates.",
    parameters=(
        Parameter(
            "CldaX",
            "1/rad",
            0.0,
            0.0,
            "change of aileron effectiveness in fully separated flow",
            Prior("normal", 0.0, 0.3, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
        ),
    ),
    channels=("aileron",),
    increments=increments,
    example=Example(
        {"CldaX": 0.08}, {"aileron": -0.1}, {"Cl": -0.006}, "0.08 x (1 - 1/4) x -0.1, by hand", known={"X": 0.25}
    ),
    source="derivative linear in the separated share 1 - X; our choice of form",
    sizes={"CldaX": (0.01, 0.6)},
)
