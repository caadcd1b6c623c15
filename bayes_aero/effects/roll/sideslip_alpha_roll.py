"""Dihedral effect that depends on the angle of attack."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior


def increments(v, s, a, known):
    """Cl += Clbea alpha beta."""
    return {"Cl": v["Clbea"] * s["alpha"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_alpha_roll",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The dihedral effect grows with the angle of attack, as that of a swept wing does with lift.",
    parameters=(
        Parameter(
            "Clbea",
            "1/rad^2",
            0.0,
            0.0,
            "change of the dihedral effect per angle of attack",
            Prior("normal", 0.0, 1.0, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT,),
            place=68,
        ),
    ),
    channels=("alpha", "beta"),
    increments=increments,
    example=Example({"Clbea": -0.5}, {"alpha": 0.2, "beta": 0.05}, {"Cl": -0.005}, "-0.5 x 0.2 x 0.05, by hand"),
    source="next term of a Taylor series; the dihedral effect of sweep is proportional to lift, as textbooks derive",
    sizes={"Clbea": (0.07, 3.0)},
)
