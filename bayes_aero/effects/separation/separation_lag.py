"""The separation point follows its static value with a lag."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior, Role
from bayes_aero.physics.separation import lagged


def increments(v, s, a, known):
    """tau1 c/V dX/dt + X = X_static, from rest at the start of each manoeuvre."""
    X = known["X"]
    return {"X": lagged(X, v["tau1"] * a.chord / s["airspeed"], s["dt"], s["start"]) - X}


EFFECT = Effect(
    name="separation_lag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.LAG,
    claim="The separation point needs time to follow the angle of attack.",
    parameters=(
        Parameter(
            "tau1",
            "c/V",
            0.0,
            5.0,
            "lag of the separation point, chords travelled",
            Prior("halfnormal", 0.0, 15.0, "up to some thirty chords; our choice"),
            (0.0, 200.0),
            role=Role.LAG,
            place=43,
        ),
    ),
    channels=("airspeed",),
    increments=increments,
    example=Example(
        {"tau1": 0.0}, {"airspeed": 60.0, "dt": 0.04, "start": 1.0}, {"X": 0.0}, "no lag", known={"X": 0.7}
    ),
    source="Goman and Khrabrov 1994",
    sizes={"tau1": (2.0, 50.0)},
    scan={"tau1": (5.0, 15.0, 30.0)},
)
