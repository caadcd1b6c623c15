"""Stall hysteresis for both signs of alpha-dot: the flow separates late and reattaches late."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """incidence += -tau2_both c/V alpha_dot, whether alpha rises or falls."""
    return {"incidence": -v["tau2_both"] * a.chord / s["airspeed"] * s["alpha_dot"]}


EFFECT = Effect(
    name="separation_hysteresis",
    kind=Kind.AERODYNAMICS,
    stage=Stage.INCIDENCE,
    claim="The flow both separates and reattaches later than in steady flow: the stall has hysteresis both ways.",
    parameters=(
        Parameter(
            "tau2_both",
            "c/V",
            0.0,
            0.0,
            "hysteresis time for both signs of alpha-dot, chords travelled",
            Prior("normal", 0.0, 25.0),
            (0.0, 200.0),  # below, lift would rise with alpha-dot without end: no motion solves the equations
        ),
    ),
    channels=("alpha_dot", "airspeed"),
    increments=increments,
    example=Example(
        {"tau2_both": 20.0},
        {"alpha_dot": 0.05, "airspeed": 60.0},
        {"incidence": -0.05},
        "20 x 3/60 x 0.05, by hand, chord 3 m",
    ),
    source="Goman and Khrabrov 1994: X depends on alpha - tau2 alpha_dot for both signs",
    sizes={"tau2_both": (2.0, 50.0)},
)
