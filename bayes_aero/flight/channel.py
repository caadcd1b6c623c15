"""Channels: what a card says about a column of a file, and what the program knows of it by name."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["STANDARD_CHANNELS", "Channel", "StandardChannel"]


@dataclass(frozen=True)
class Channel:
    """Where a channel stands in a file and in which unit.

    Attributes:
        name: the channel inside the program, e.g. "alpha"; in SI there.
        unit: the unit in the file, e.g. "deg".
        label: its name in files with headers (.csv .mat .parquet .nc); without one, `name` is looked for.
        column: its column, counted from 1, in files without a header (.asc).
        required: whether a file without it is refused. A channel that is not required is left out of the
            record.
        sign: -1 where the file counts the other way: a load factor that is positive upward for az, an
            elevator that is positive trailing edge up.
    """

    name: str
    unit: str
    label: str | None = None
    column: int | None = None
    required: bool = True
    sign: int = 1

    @property
    def heading(self) -> str:
        """The name to look for in a file with headers."""
        return self.name if self.label is None else self.label


@dataclass(frozen=True)
class StandardChannel:
    """A channel that the program knows.

    Attributes:
        name: its name.
        unit: its SI unit.
        description: what it is.
        plausible: bounds, in `unit`, that no sound record leaves. Wide: they catch wrong units, not odd
            flying.
        hint: what a value outside usually means.
    """

    name: str
    unit: str
    description: str
    plausible: tuple[float, float]
    hint: str = ""


_DEG = 'looks like degrees: set unit = "deg" for it on the card'
_DEG_S = 'looks like degrees per second: set unit = "deg/s" for it on the card'
_DEG_S2 = 'looks like degrees per second squared: set unit = "deg/s^2" for it on the card'
_PERCENT = 'looks like per cent: set unit = "%" for it on the card'
_SPEED = 'looks like another unit of speed: set unit = "kt" or "km/h" for it on the card'
_FEET = 'looks like feet: set unit = "ft" for it on the card'
_KELVIN = 'looks like another scale: set unit = "degC" or "K" for it on the card'
_PASCAL = 'hPa and Pa are easily confused: set unit = "Pa" or "hPa" for it on the card'
_DENSITY = "set its unit on the card: air at sea level has 1.225 kg/m^3"

_TABLE = (
    # name, SI unit, description, plausible lo, hi, hint
    ("time", "s", "time", -1e9, 1e10, ""),
    ("ax", "m/s^2", "specific force at the accelerometer, body x (forward)", -200.0, 200.0, ""),
    ("ay", "m/s^2", "specific force at the accelerometer, body y (right)", -200.0, 200.0, ""),
    (
        "az",
        "m/s^2",
        "specific force at the accelerometer, body z (down); level flight -9.8",
        -200.0,
        200.0,
        "",
    ),
    ("p", "rad/s", "roll rate", -10.0, 10.0, _DEG_S),
    ("q", "rad/s", "pitch rate", -5.0, 5.0, _DEG_S),
    ("r", "rad/s", "yaw rate", -5.0, 5.0, _DEG_S),
    ("phi", "rad", "bank angle", -20.0, 20.0, _DEG),  # unwrapped rolls are allowed
    ("theta", "rad", "pitch attitude", -1.6, 1.6, _DEG),
    ("psi", "rad", "heading", -40.0, 40.0, _DEG),  # unwrapped turns are allowed
    ("alpha", "rad", "angle of attack", -1.6, 1.6, _DEG),
    ("beta", "rad", "sideslip", -1.6, 1.6, _DEG),
    ("alpha_dot", "rad/s", "rate of angle of attack", -10.0, 10.0, _DEG_S),
    ("beta_dot", "rad/s", "rate of sideslip", -10.0, 10.0, _DEG_S),
    ("p_dot", "rad/s^2", "roll acceleration", -100.0, 100.0, _DEG_S2),
    ("q_dot", "rad/s^2", "pitch acceleration", -100.0, 100.0, _DEG_S2),
    ("r_dot", "rad/s^2", "yaw acceleration", -100.0, 100.0, _DEG_S2),
    ("airspeed", "m/s", "true airspeed", 0.0, 400.0, _SPEED),
    ("calibrated_airspeed", "m/s", "calibrated airspeed", -10.0, 400.0, _SPEED),
    ("mach", "1", "Mach number", -0.01, 3.0, ""),
    ("altitude", "m", "pressure altitude", -1000.0, 40000.0, _FEET),
    ("radio_altitude", "m", "radio altitude", -1000.0, 40000.0, _FEET),
    ("elevator", "rad", "elevator deflection, trailing edge down positive", -1.6, 1.6, _DEG),
    ("stabilizer", "rad", "horizontal-tail trim angle", -1.6, 1.6, _DEG),
    ("rudder", "rad", "rudder deflection", -1.6, 1.6, _DEG),
    ("aileron_left", "rad", "left aileron deflection", -1.6, 1.6, _DEG),
    ("aileron_right", "rad", "right aileron deflection", -1.6, 1.6, _DEG),
    ("flap", "rad", "flap deflection", -1.6, 1.6, _DEG),
    ("spoiler_left", "rad", "left spoiler deflection", -1.6, 1.6, _DEG),
    ("spoiler_right", "rad", "right spoiler deflection", -1.6, 1.6, _DEG),
    ("dlc_left", "rad", "left direct-lift flap deflection", -1.6, 1.6, _DEG),
    ("dlc_right", "rad", "right direct-lift flap deflection", -1.6, 1.6, _DEG),
    ("n1_left", "1", "left engine speed, fraction", -0.1, 2.0, _PERCENT),
    ("n1_right", "1", "right engine speed, fraction", -0.1, 2.0, _PERCENT),
    ("thrust_left", "N", "left net thrust", -1e6, 1e6, 'looks too large: is its unit "N", "kN" or "lbf"?'),
    ("thrust_right", "N", "right net thrust", -1e6, 1e6, 'looks too large: is its unit "N", "kN" or "lbf"?'),
    ("thrust", "N", "total net thrust", -2e6, 2e6, 'looks too large: is its unit "N", "kN" or "lbf"?'),
    ("fuel_used", "kg", "fuel used", -1e3, 3e5, ""),
    ("static_temperature", "K", "static temperature", 150.0, 350.0, _KELVIN),
    ("static_pressure", "Pa", "static pressure", 1200.0, 1.2e5, _PASCAL),
    ("density", "kg/m^3", "air density", 0.0, 2.0, _DENSITY),
    ("latitude", "rad", "latitude", -1.6, 1.6, _DEG),
    ("longitude", "rad", "longitude", -6.3, 6.3, _DEG),
    ("gear", "1", "landing gear, 0 up", -1.0, 100.0, ""),
)

STANDARD_CHANNELS: dict[str, StandardChannel] = {
    name: StandardChannel(name, unit, description, (lo, hi), hint) for name, unit, description, lo, hi, hint in _TABLE
}
