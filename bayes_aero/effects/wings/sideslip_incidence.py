"""Sideslip raises the incidence of the windward wing."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """incidence_difference += sideslip_incidence beta."""
    return {"incidence_difference": v["sideslip_incidence"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_incidence",
    kind=Kind.AERODYNAMICS,
    stage=Stage.INCIDENCE,
    claim="In sideslip the windward wing stalls before the other (after it, where negative).",
    parameters=(
        Parameter(
            "sideslip_incidence",
            "1",
            0.0,
            0.0,
            "difference of incidence, right less left wing, per sideslip",
            Prior("normal", 0.0, 0.5, "twice the dihedral angle, and sweep; our choice of width"),
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example({"sideslip_incidence": 0.2}, {"beta": 0.05}, {"incidence_difference": 0.01}, "0.2 x 0.05, by hand"),
    source="a wing with dihedral meets sideslip at an incidence, by geometry; sweep lumped with it is our choice",
    sizes={"sideslip_incidence": (0.05, 2.0)},
)
