"""Drag due to sideslip."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CD += CDb2 beta^2: even in beta, for the aircraft is symmetric."""
    return {"CD": v["CDb2"] * s["beta"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Sideslip adds drag.",
    parameters=(Parameter("CDb2", "1/rad^2", 0.0, 0.0, "drag per sideslip squared", Prior("normal", 0.0, 2.5)),),
    channels=("beta",),
    increments=increments,
    example=Example({"CDb2": 0.8}, {"beta": 0.05}, {"CD": 0.002}, "0.8 x (0.05)^2, by hand"),
    source="lowest even term of a Taylor series, by symmetry; our choice of form",
    sizes={"CDb2": (0.2, 5.0)},
)
