"""Pitching moment due to sideslip."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmb2 beta^2: even in beta, for the aircraft is symmetric."""
    return {"Cm": v["Cmb2"] * s["beta"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Sideslip pitches the aircraft.",
    parameters=(
        Parameter("Cmb2", "1/rad^2", 0.0, 0.0, "pitching moment per sideslip squared", Prior("normal", 0.0, 5.0)),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"Cmb2": -2.0}, {"beta": 0.1}, {"Cm": -0.02}, "-2 x (0.1)^2, by hand"),
    source="lowest even term of a Taylor series, by symmetry; our choice of form",
    sizes={"Cmb2": (0.4, 10.0)},
)
