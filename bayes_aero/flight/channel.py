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
    """

    name: str
    unit: str
    description: str
    plausible: tuple[float, float]


_TABLE = (
    # name, SI unit, description, plausible lo, hi
    ("time", "s", "time", -1e9, 1e10),
    ("ax", "m/s^2", "specific force at the accelerometer, body x (forward)", -200.0, 200.0),
    ("ay", "m/s^2", "specific force at the accelerometer, body y (right)", -200.0, 200.0),
    (
        "az",
        "m/s^2",
        "specific force at the accelerometer, body z (down); level flight -9.8",
        -200.0,
        200.0,
    ),
    ("p", "rad/s", "roll rate", -10.0, 10.0),
    ("q", "rad/s", "pitch rate", -5.0, 5.0),
    ("r", "rad/s", "yaw rate", -5.0, 5.0),
    ("phi", "rad", "bank angle", -20.0, 20.0),  # unwrapped rolls are allowed
    ("theta", "rad", "pitch attitude", -1.6, 1.6),
    ("psi", "rad", "heading", -40.0, 40.0),  # unwrapped turns are allowed
    ("alpha", "rad", "angle of attack", -1.6, 1.6),
    ("beta", "rad", "sideslip", -1.6, 1.6),
    ("alpha_dot", "rad/s", "rate of angle of attack", -10.0, 10.0),
    ("beta_dot", "rad/s", "rate of sideslip", -10.0, 10.0),
    ("p_dot", "rad/s^2", "roll acceleration", -100.0, 100.0),
    ("q_dot", "rad/s^2", "pitch acceleration", -100.0, 100.0),
    ("r_dot", "rad/s^2", "yaw acceleration", -100.0, 100.0),
    ("airspeed", "m/s", "true airspeed", 0.0, 400.0),
    ("calibrated_airspeed", "m/s", "calibrated airspeed", -10.0, 400.0),
    ("mach", "1", "Mach number", -0.01, 3.0),
    ("altitude", "m", "pressure altitude", -1000.0, 40000.0),
    ("radio_altitude", "m", "radio altitude", -1000.0, 40000.0),
    ("elevator", "rad", "elevator deflection, trailing edge down positive", -1.6, 1.6),
    ("elevator_left", "rad", "left elevator deflection, trailing edge down positive", -1.6, 1.6),
    ("elevator_right", "rad", "right elevator deflection, trailing edge down positive", -1.6, 1.6),
    ("elevon_left", "rad", "left elevon deflection, trailing edge down positive", -1.6, 1.6),
    ("elevon_right", "rad", "right elevon deflection, trailing edge down positive", -1.6, 1.6),
    ("canard", "rad", "canard deflection, trailing edge down positive", -1.6, 1.6),
    ("stabilizer", "rad", "horizontal-tail trim angle", -1.6, 1.6),
    ("rudder", "rad", "rudder deflection", -1.6, 1.6),
    ("aileron", "rad", "aileron deflection, half of right less left, trailing edge down positive", -1.6, 1.6),
    ("aileron_left", "rad", "left aileron deflection", -1.6, 1.6),
    ("aileron_right", "rad", "right aileron deflection", -1.6, 1.6),
    ("flap", "rad", "flap deflection", -1.6, 1.6),
    ("spoiler_left", "rad", "left spoiler deflection", -1.6, 1.6),
    ("spoiler_right", "rad", "right spoiler deflection", -1.6, 1.6),
    ("dlc_left", "rad", "left direct-lift flap deflection", -1.6, 1.6),
    ("dlc_right", "rad", "right direct-lift flap deflection", -1.6, 1.6),
    ("n1_left", "1", "left engine speed, fraction", -0.1, 2.0),
    ("n1_right", "1", "right engine speed, fraction", -0.1, 2.0),
    ("engine_speed", "rad/s", "speed of the engine or propeller", -1.0, 2e4),
    ("throttle", "1", "throttle or power lever, fraction", -0.5, 2.0),
    ("throttle_left", "1", "left throttle, fraction", -0.5, 2.0),
    ("throttle_right", "1", "right throttle, fraction", -0.5, 2.0),
    ("thrust_left", "N", "left net thrust", -1e6, 1e6),
    ("thrust_right", "N", "right net thrust", -1e6, 1e6),
    ("thrust", "N", "total net thrust", -2e6, 2e6),
    ("fuel_used", "kg", "fuel used", -1e3, 3e5),
    ("static_temperature", "K", "static temperature", 150.0, 350.0),
    ("static_pressure", "Pa", "static pressure", 1200.0, 1.2e5),
    ("dynamic_pressure", "Pa", "dynamic pressure, half of density times true airspeed squared", -500.0, 1.5e5),
    ("density", "kg/m^3", "air density", 0.0, 2.0),
    ("latitude", "rad", "latitude", -1.6, 1.6),
    ("longitude", "rad", "longitude", -6.3, 6.3),
    ("gear", "1", "landing gear, 0 up", -1.0, 100.0),
)

STANDARD_CHANNELS: dict[str, StandardChannel] = {
    name: StandardChannel(name, unit, description, (lo, hi)) for name, unit, description, lo, hi in _TABLE
}
