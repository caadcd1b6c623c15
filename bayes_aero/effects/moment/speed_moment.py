"""Pitching moment that changes with airspeed."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.rates import speed_ratio


def increments(v, s, a, known):
    """Cm += CmV V/V0; V0 is the card's reference_speed, or 100 m/s where the card names none.

    A stand-in, at one altitude, for Mach number, thrust and elasticity alike, so diagnosis never proposes it.
    """
    return {"Cm": v["CmV"] * speed_ratio(s["airspeed"], a)}


EFFECT = Effect(
    name="speed_moment",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The pitching moment coefficient changes with airspeed.",
    parameters=(Parameter("CmV", "1", 0.0, 0.0, "pitching moment per V/V0", Prior("normal", 0.0, 0.3)),),
    channels=("airspeed",),
    increments=increments,
    example=Example({"CmV": -0.1}, {"airspeed": 80.0}, {"Cm": -0.08}, "-0.1 x 80/100, by hand, V0 100 m/s"),
    source="Jategaonkar 2015, longitudinal model of the HFB 320",
    sizes={"CmV": (0.01, 0.5)},
    candidate=False,
)
