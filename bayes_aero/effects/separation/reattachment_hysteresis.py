"""Stall hysteresis while the angle of attack falls: the flow reattaches late."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """incidence += -tau2 c/V alpha_dot where alpha_dot <= 0, nothing where alpha rises (one-sided, as published)."""
    return {"incidence": -v["tau2"] * a.chord / s["airspeed"] * xp.minimum(s["alpha_dot"], 0.0)}


EFFECT = Effect(
    name="reattachment_hysteresis",
    kind=Kind.AERODYNAMICS,
    stage=Stage.INCIDENCE,
    claim="The flow reattaches later than it separated: the stall has hysteresis while the angle of attack falls.",
    parameters=(
        Parameter(
            "tau2",
            "c/V",
            0.0,
            15.0,
            "quasi-steady hysteresis time, chords travelled",
            Prior("normal", 15.0, 15.0, "minus 15 to 45 chords with 95 %; our choice"),
            (-50.0, 200.0),
            place=44,
        ),
    ),
    channels=("alpha_dot", "airspeed"),
    increments=increments,
    example=Example({"tau2": 20.0}, {"alpha_dot": -0.05, "airspeed": 60.0}, {"incidence": 0.05}, "by hand, chord 3 m"),
    source="Fischenberg and Jategaonkar 1999; one-sided in the program published with the ATTAS data",
    sizes={"tau2": (2.0, 50.0)},
)
