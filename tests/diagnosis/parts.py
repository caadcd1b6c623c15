"""Parts of a diagnosis that are made up, for tests of what is judged and not of what is fitted."""

from dataclasses import fields

from bayes_aero.diagnosis.result import Cause, Gain
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.effects import CATALOGUE


def part(kind, **given):
    """An instance of a dataclass with these fields alone: what is judged here needs no aircraft."""
    made = object.__new__(kind)
    for name, value in given.items():
        assert name in {f.name for f in fields(kind)}
        object.__setattr__(made, name, value)
    return made


def cause(name="thrust_scale", mean=-0.08, sd=0.01, **given) -> Cause:
    parameters = {p.name: Size(mean, sd, p.unit) for p in CATALOGUE[name].parameters}
    gain = Gain(1.0, 1.0, "manoeuvre", {}, {})
    rest = {"probability": 0.9, "p_value": 0.01, "ambiguous_with": ()} | given
    return Cause(name, "propulsion", CATALOGUE[name].claim, "coefficients", parameters=parameters, gain=gain, **rest)
