"""Each thing that can be wrong with the samples is told with channel, sample and remedy; sound odd flying passes."""

import numpy as np
import pytest
from flight_samples import sound

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.checks import MIN_SAMPLES, check_record
from bayes_aero.units import si_unit

T = np.arange(120) * 0.04


def put(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = np.array(values)
    changed[index] = value
    return changed


def told(record, *words: str, **options) -> None:
    with pytest.raises(InputError) as caught:
        check_record(record, **options)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, f"{word!r} is not in {message!r}"


def test_sound_odd_and_uneven_records_pass():
    check_record(sound())
    check_record(sound(MIN_SAMPLES))
    check_record(sound(alpha=1.5 * np.sin(T)))  # post-stall
    check_record(sound(phi=np.linspace(0, 12, 120)))  # two rolls, unwrapped
    check_record(sound(alpha=0.01 + 0.001 * np.sin(T)))  # a fast, calm record is not "converted twice"
    check_record(sound(ax=0.0 * T, ay=0.0 * T, az=0.05 * np.sin(T)))  # a parabola
    check_record(sound(strain=1e9 * T))  # the user's own channel: no bounds are known
    check_record(sound(time=T + 5e4))
    check_record(sound(time=np.round(T + 1e-5 * np.sin(np.arange(120)), 5)))  # as in the second ATTAS file
    check_record(sound(time=put(T, 40, T[40] + 0.01)), even=False)
    told(sound(time=put(T, 40, T[39])), "repeats", even=False)


CASES = {
    "short": (
        {"time": T[:49], **{k: v[:49] for k, v in sound().channels.items()}},
        ("49 samples", "50", "use a longer record"),
    ),
    "nan": (
        {"q": put(put(sound()["q"], 11, np.nan), 50, np.nan)},
        ("channel q", "NaN", "sample 11 ", "t = 0.44 s", "2 of 120", "repair"),
    ),
    "inf": ({"strain": put(T, 3, -np.inf)}, ("channel strain", "infinite", "sample 3 ", "repair")),
    "nan time": ({"time": put(T, 5, np.nan)}, ("channel time", "NaN", "sample 5 ", "repair")),
    "repeated time": ({"time": put(T, 30, T[29])}, ("channel time", "repeats", "sample 30 ", "drop the repeated")),
    "backwards": (
        {"time": np.r_[T[:60], T[:60]]},
        ("channel time", "backwards", "sample 60 ", "where time starts over"),
    ),
    "gap": ({"time": T + (np.arange(120) > 70) * 0.2}, ("channel time", "gap", "sample 70 ", "0.24 s", "--split")),
    "jitter": ({"time": put(T, 40, T[40] + 0.002)}, ("channel time", "unevenly", "sample 39 ", "--resample 0.04")),
    "milliseconds": ({"time": T * 1e3}, ("channel time", "40 s", "sample 0 ", 'unit = "ms"')),
    "days": ({"time": T / 86400}, ("channel time", "sample 0 ", "days")),
    "alpha in degrees": (
        {"alpha": np.rad2deg(sound()["alpha"])},
        ("channel alpha", "sample 0 ", "t = 0 s", "looks like degrees", 'unit = "deg"'),
    ),
    "theta in degrees": ({"theta": 5 + T}, ("channel theta", "sample 0 ", 'unit = "deg"')),
    "q in degrees per second": ({"q": 6 * np.sin(T)}, ("channel q", "sample 25 ", 'unit = "deg/s"')),
    "fast": ({"airspeed": np.full(120, 450.0)}, ("channel airspeed", "450 m/s", "sample 0 ", '"kt"')),
    "dense": ({"density": put(T * 0 + 1.2, 9, 2.5)}, ("channel density", "2.5 kg/m^3", "sample 9 ", "unit")),
    "n1 in per cent": ({"n1_left": 80 + T}, ("channel n1_left", "sample 0 ", 'unit = "%"')),
    "pressure in hPa": ({"static_pressure": 510 + T}, ("channel static_pressure", "sample 0 ", '"hPa"')),
    "pressure beyond any unit": ({"static_pressure": 5.1e6 + T}, ("channel static_pressure", "no other unit")),
    "celsius": ({"static_temperature": T - 20}, ("channel static_temperature", '"degC"')),
    "no airspeed": (
        {"airspeed": put(put(T + 50, 17, 0.0), 90, -1.0)},
        ("channel airspeed", "is 0 m/s", "sample 17 ", "2 samples", "cut the record"),
    ),
    "no density": ({"density": put(T + 0.7, 8, 0.0).clip(0, 1)}, ("channel density", "sample 8 ", "repair")),
    "constant alpha": (
        {"alpha": np.full(120, 0.09)},
        ("channel alpha", "stays at 0.09 rad", "sample 0 ", "sample 119 ", "check the sensor"),
    ),
    "g": ({"ax": 0.1 + 0 * T, "ay": 0 * T, "az": -1.0 - 0.1 * np.sin(T)}, ("ax, ay, az", "sample ", 'unit = "g"')),
}


@pytest.mark.parametrize("case", CASES)
def test_told(case):
    changed, words = CASES[case]
    told(sound(**changed), *words)


def test_the_unit_that_the_card_has_is_not_advised():
    hpa = [Channel("static_pressure", "hPa")]  # of a file in Pa
    told(sound(static_pressure=5.1e6 + T), 'looks like Pa: set unit = "Pa"', channels=hpa)
    ms = [Channel("time", "ms")]  # of a file in microseconds
    told(sound(time=T * 1e3), 'set unit = "us"', channels=ms)


@pytest.mark.parametrize("value", [-9999.0, 9999.0, 99999.0])
def test_a_fill_value_is_told_before_any_unit(value):
    degrees = [Channel("alpha", "deg")]
    filled = sound(alpha=put(put(sound()["alpha"], 11, np.deg2rad(value)), 50, np.deg2rad(value)))
    told(filled, f"{value:.10g} deg stands at 2 of 120 samples", "sample 11 ", "fill value", channels=degrees)


def test_the_table_of_channels():
    for name, known in STANDARD_CHANNELS.items():
        assert known.name == name
        assert known.plausible[0] < known.plausible[1]
        assert known.description
        if known.unit not in ("N", "Pa"):
            assert si_unit(known.unit) == known.unit.replace("^", "**")
