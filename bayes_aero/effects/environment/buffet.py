"""Separated flow shakes the aircraft: the lift fluctuates."""

from bayes_aero.effect import Disturbance, Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL += buffet (1 - X); `buffet` is the fluctuation of the lift coefficient of wholly separated flow."""
    return {"CL": s["buffet"] * (1.0 - known["X"])}


def rate(v, s, a):
    """V / (length c), 1/s: eddies pass the aircraft at its airspeed."""
    return s["airspeed"] / (v["buffet_length"] * a.chord)


EFFECT = Effect(
    name="buffet",
    kind=Kind.ENVIRONMENT,
    stage=Stage.TOTAL,
    claim="Buffet of separated flow shakes the lift.",
    parameters=(
        Parameter(
            "buffet",
            "1",
            0.0,
            0.05,
            "standard deviation of the lift coefficient of fully separated flow",
            Prior("halfnormal", 0.0, 0.2, "heavy buffet shakes the normal force by a tenth of itself; our choice"),
            (0.0, 2.0),
        ),
        Parameter(
            "buffet_length",
            "c/V",
            3.0,
            3.0,
            "correlation of buffet, chords travelled",
            Prior("lognormal", 3.0, 0.7, "reduced frequencies f c/V of a few hundredths to a few tenths; our choice"),
            (0.3, 50.0),
        ),
    ),
    channels=("buffet",),
    increments=increments,
    example=Example(
        {"buffet": 0.1, "buffet_length": 3.0},
        {"buffet": 0.08},
        {"CL": 0.06},
        "0.08 x (1 - 1/4), by hand",
        known={"X": 0.25},
    ),
    source="Mabey 1973, J. Aircraft 10, 642 (buffet over the separated part of a wing); of first order, our choice",
    sizes={"buffet": (0.005, 0.5), "buffet_length": (0.5, 30.0)},
    candidate=False,
    disturbance=Disturbance("buffet", "1", "buffet", rate),
)
