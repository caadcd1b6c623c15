"""The aircraft's constants on a starter card: nothing of them can be read off a record."""

from __future__ import annotations

from collections.abc import Iterator

from bayes_aero.flight.aircraft import AIRCRAFT_KEYS

MEANING = {
    "mass": "of the flight, with fuel and crew",
    "Ix": "moment of inertia about the roll axis",
    "Iy": "moment of inertia about the pitch axis",
    "Iz": "moment of inertia about the yaw axis",
    "Ixz": 'product of inertia; "0 kg m^2" if nobody knows it',
    "wing_area": "reference area of CL, CD and Cm",
    "chord": "mean aerodynamic chord",
    "span": "of the wing, from tip to tip",
    "tail_arm": "from the centre of gravity to the tailplane's quarter chord",
}
POSITION = '["0 m", "0 m", "0 m"]'
PLACES = {
    "reference_point": "that Cm is referred to, if it is not the centre of gravity",
    "accelerometer": "where ax and az are measured",
    "engine": "where the total thrust acts",
}


def aircraft_block() -> Iterator[str]:
    """Lines of `[aircraft]`: what is needed as TODO with its unit, what is optional as a comment."""
    yield "[aircraft]"
    for key, meaning in MEANING.items():
        yield f'{key} = "TODO" # {meaning}; write "... {AIRCRAFT_KEYS[key]}", or another unit of the kind'
    yield "# aspect_ratio = 7.0 # left out, it is span squared over wing area"
    yield "# Positions from the centre of gravity, x forward, y right, z down; left out, they are zero."
    for key, meaning in PLACES.items():
        yield f"# {key} = {POSITION} # {meaning}"
    yield '# lateral_length = "10 m" # of rolling and yawing moment; left out, it is the span'
    yield '# lateral_rate_length = "5 m" # l in p l/V and r l/V; left out, it is half the span: p b/2V'
    yield '# engine_arm = "3 m" # of a left and a right engine from the plane of symmetry'
    yield '# engine_inclination = "0 deg" # of the thrust line, nose up'
