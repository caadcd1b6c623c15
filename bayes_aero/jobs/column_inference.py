"""Guess what the columns of an unknown file are: names from headings, units and signs from the values' own physics.

Nothing here is certain, and every guess carries its evidence: it is meant to be read by a person.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches

import numpy as np

from bayes_aero.flight.channel import (
    ALIASES,
    STANDARD_CHANNELS,
    is_command,
    plain_heading,
    side_of,
    split_heading,
    symbol_of,
)
from bayes_aero.flight.reading import RawColumn
from bayes_aero.physics.aircraft import GRAVITY, standard_air
from bayes_aero.units import canonical, to_si

ALIKE = 0.84  # likeness of a heading to a known one
ANGLE = 1.6  # rad; no angle of attack, attitude or deflection of a sound record is larger
FASTEST = 6.0  # rad/s; no aircraft of these records turns faster, and deg/s commonly are more; our choice
STEEP = 0.7  # rad; more is no attitude of a flight in which none exceeds `ANGLE`; our choice
BETWEEN = math.sqrt(180.0 / math.pi)  # times one unit of angle, midway to the other on a logarithmic scale
TURN, TURNING = 6.4, ("phi", "psi")  # rad; a heading in radians reaches 6.28, a bank in a roll, too
MIDDLING = 0.9  # kg/m3, within a third of the air's from sea level to 6 km
USUAL = (("m/s", "m"), ("kt", "ft"), ("ft/s", "ft"), ("km/h", "m"))  # units of airspeed and height in one file
UNTOLD = 0.2  # logarithm of a ratio, within which short records cannot tell two pairs; our choice
CLEAR = 0.9  # correlation from which noise lessens a slope by a fifth at most; our choice
FRACTIONS = ("n1_left", "n1_right", "throttle", "throttle_left", "throttle_right")


def guessed(columns: Sequence[RawColumn]) -> tuple[dict[str, Guess], list[RawColumn]]:
    """Channels by name, and the columns that remain unknown."""
    found: dict[str, Guess] = {}
    unknown = []
    for loose in (False, True):  # exact names first, so that a resemblance never takes a place
        for column in columns:
            if any(guess.column is column for guess in found.values()):
                continue
            guess = _named(column, loose)
            if guess is not None and guess.channel not in found:
                found[guess.channel] = guess
            elif loose:
                unknown.append(column)
    for step in STEPS:
        step(found)
    return found, unknown


def _named(column: RawColumn, loose: bool) -> Guess | None:
    """By the first of its names that says something; files with two rows of names have two."""
    if column.label is None or column.values is None:
        return None
    names = dict.fromkeys((column.label, *column.heading.names))
    return next((guess for name in names if (guess := _called(column, name, loose)) is not None), None)


def _called(column: RawColumn, name: str, loose: bool) -> Guess | None:
    heading = name
    key, evidence = split_heading(heading)[0], f"the heading {name!r}"
    channel = ALIASES.get(key)
    if channel is None:
        heading = plain_heading(name)
        key = split_heading(heading)[0]
        channel = ALIASES.get(key)
    if channel is None and (sided := side_of(name)) is not None:
        channel = ALIASES.get(split_heading(sided[0])[0])
        channel = f"{channel}_{sided[1]}" if f"{channel}_{sided[1]}" in SI else None
        heading, evidence = (sided[0], f"{evidence}, the {sided[1]} one") if channel else (heading, evidence)
    if channel is None and loose and len(key) > 3 and not is_command(name):
        close = get_close_matches(key, ALIASES, n=1, cutoff=ALIKE)
        channel = ALIASES[close[0]] if close else None
        if sided is not None and f"{channel}_{sided[1]}" in SI:
            channel = f"{channel}_{sided[1]}"  # one of two, not the whole
        evidence += f" resembles {close[0]!r}" if close else ""
    symbol = symbol_of(name) if channel is None and loose else None
    if symbol is not None:
        channel = ALIASES[symbol]
        evidence += f" ends with {symbol!r}"
    if channel is None:
        return None
    si = SI.get(channel)
    told = [column.unit, split_heading(heading, si)[1], split_heading(symbol, si)[1] if symbol else None]
    for unit in (canonical(unit, si) for unit in told if unit):
        with suppress(ValueError):  # values in this unit cannot be the channel
            if unit:
                to_si(0.0, unit, channel, si)
                return Guess(channel, column, unit, evidence=f"{evidence} and its unit {unit}")
    return Guess(channel, column, None, evidence=evidence)


# --- The steps, in the order of `STEPS`: each changes guesses by what the values of others say.


def unit_of_time(found: dict[str, Guess]) -> None:
    guess = found.get("time")
    if guess is not None and guess.unit is None:
        step = float(np.median(np.diff(guess.values)))
        found["time"] = guess.because(f"its median step is {step:.6g}", unit="ms" if step > 2.0 else "s")


def angles_by_rates(found: dict[str, Guess]) -> None:
    """Bank and pitch attitude change as the roll and pitch rates say, which tells their units apart.

    Where neither unit is stated, the two tell each other only if they differ.
    """
    step = step_of(found)
    for name, attitude in (("p", "phi"), ("q", "theta")):
        rate, angle = found.get(name), found.get(attitude)
        if rate is None or angle is None or step is None or angle.unit is not None:
            continue
        turning, stated = np.gradient(smooth(angle.values)) / step, rate.unit is not None
        slope = slope_of(smooth(rate.si), turning) if alike(smooth(rate.si), turning) else None
        if slope is None or not (stated or abs(math.log(abs(slope))) > math.log(BETWEEN)):
            continue
        unit, other = ("deg", "rad/s") if abs(slope) > BETWEEN else ("rad", "deg/s")
        why = f"it changes at {abs(slope):.2g} times {name}{' in rad/s' if stated else ''}"
        found[attitude] = angle.because(why, unit=unit)
        if not stated:
            found[name] = rate.because(f"{attitude} changes at {abs(slope):.2g} times it", unit=other)


def angles_by_path(found: dict[str, Guess]) -> None:
    """Pitch attitude less angle of attack is the angle of the path, as climb and airspeed make it where their units are
    stated."""
    step, names = step_of(found), ("theta", "alpha", "airspeed", "altitude")
    if step is None or not all(name in found for name in names):
        return
    theta, alpha, speed, height = (found[name] for name in names)
    missing = [g for g in (theta, alpha) if g.unit is None]
    if not missing or speed.unit is None or height.unit is None:
        return
    path = np.arcsin(np.clip(np.gradient(smooth(height.si)) / step / np.maximum(smooth(speed.si), 1.0), -1.0, 1.0))
    if len(missing) == 2:
        said, meant = theta.values - alpha.values, path
    elif theta.unit is None:
        said, meant = theta.values, alpha.si + path
    else:
        said, meant = alpha.values, theta.si - path
    said, meant = smooth(said), smooth(meant)
    slope = slope_of(meant, said) if alike(said, meant) else None
    if slope is None or slope <= 0.0:
        return
    unit = "deg" if slope > BETWEEN else "rad"
    why = f"theta - alpha is the angle of the climb in {unit}"
    found |= {g.channel: g.because(why, unit=unit) for g in missing}


def angles_by_size(found: dict[str, Guess]) -> None:
    """Beyond 1.6 it can only be degrees, a heading or bank beyond a turn; smaller ones go with the rest of the file.

    A heading comes from another instrument: it tells of the others only where they are large, too.
    """
    angles = {name: g for name, g in found.items() if SI.get(name) == "rad"}
    large = [n for n, g in angles.items() if g.unit is None and largest(g) > (TURN if n in TURNING else ANGLE)]
    stated = [g.unit for g in angles.values() if g.unit is not None]
    others = max((largest(g) for n, g in angles.items() if n not in TURNING and g.unit is None), default=0.0)
    degrees = any(n != "psi" for n in large) or (bool(large) and others > STEEP)
    degrees = degrees or (bool(stated) and all(u == "deg" for u in stated))
    for name, guess in angles.items():
        if guess.unit is None:
            why = f"it reaches {largest(guess):.3g}"
            if name not in large:
                why += ", and other angles of the file are in degrees" if degrees else ", too little for degrees"
            found[name] = guess.because(why, unit="deg" if degrees or name in large else "rad")


def rates_by_angles(found: dict[str, Guess]) -> None:
    """Unit and sign of each rate from the attitude that it changes; what that does not tell goes with the others.

    One instrument gives all three: a small rate in degrees is as large as another in radians.
    """
    step = step_of(found)
    for name, attitude in (("p", "phi"), ("q", "theta")):
        guess, angle = found.get(name), found.get(attitude)
        if guess is None or angle is None or step is None:
            continue
        turning = np.gradient(smooth(np.unwrap(angle.si))) / step
        slope = slope_of(guess.values, turning) if alike(smooth(guess.values), turning) else None
        if slope is None or abs(slope) < 1e-3:
            continue
        unit = guess.unit or ("rad/s" if abs(slope) > math.sqrt(math.pi / 180.0) else "deg/s")
        expected = 1.0 if unit == "rad/s" else math.pi / 180.0
        found[name] = guess.because(
            f"{attitude} changes at {slope / expected:.2g} times it", unit=unit, sign=1 if slope > 0.0 else -1
        )
    yaw_rate(found)
    rates = [found[name] for name in ("p", "q", "r") if name in found]
    stated = [guess for guess in rates if guess.unit is not None]  # the yaw rate may be of another instrument
    known = {guess.unit: guess.channel for guess in stated if guess.channel != "r" or len(stated) == 1}
    reach = max((largest(guess) for guess in rates), default=0.0)
    angles = [g.unit for name, g in found.items() if SI.get(name) == "rad"]
    for guess in rates:
        if guess.unit is None and len(known) == 1 and (largest(guess) <= FASTEST or "deg/s" in known):
            unit, beside = next(iter(known.items()))
            found[guess.channel] = guess.because(f"as {beside}", unit=unit)
        elif guess.unit is None:
            own = largest(guess) if known else reach  # what differs from the others is judged by itself
            unit = "deg/s" if own > ANGLE or (not known and angles.count("deg") > len(angles) / 2) else "rad/s"
            found[guess.channel] = guess.because(f"the rates reach {reach:.3g}", unit=unit)


def yaw_rate(found: dict[str, Guess]) -> None:
    """Unit of the yaw rate from the heading, r = psi' cos(theta) cos(phi) - theta' sin(phi), else from the bank of a
    turn, r = g sin(phi) cos(theta) / V: no unit of airspeed is as far from another as degrees are from radians."""
    guess, step = found.get("r"), step_of(found)
    if guess is None or guess.unit is not None or step is None:
        return
    zero = np.zeros(len(guess.values))
    phi, theta = (found[name].si if name in found else zero for name in ("phi", "theta"))
    ways: list[tuple[str, np.ndarray]] = []
    if "psi" in found:
        psi, pitching = np.gradient(smooth(np.unwrap(found["psi"].si))) / step, np.gradient(smooth(theta)) / step
        ways.append(("heading", psi * np.cos(theta) * np.cos(phi) - pitching * np.sin(phi)))
    if "airspeed" in found and "phi" in found:
        ways.append(("bank", GRAVITY * np.sin(phi) * np.cos(theta) / np.maximum(found["airspeed"].values, 1.0)))
    for of, turning in ways:
        own = smooth(guess.values)
        slope = slope_of(turning, own) if alike(own, turning) else None
        if slope is not None and abs(slope) > 1e-3:
            unit = "deg/s" if abs(slope) > BETWEEN else "rad/s"
            why = f"it is {abs(slope):.2g} times what the {of} makes in rad/s"
            found["r"] = guess.because(why, unit=unit)
            return


def accelerations_of_rates(found: dict[str, Guess]) -> None:
    """Unit of an angular acceleration from the rate that it changes."""
    step = step_of(found)
    for name, of in (("p_dot", "p"), ("q_dot", "q"), ("r_dot", "r"), ("alpha_dot", "alpha"), ("beta_dot", "beta")):
        guess, rate = found.get(name), found.get(of)
        if guess is None or guess.unit is not None or rate is None or step is None:
            continue
        slope = slope_of(smooth(guess.values), np.gradient(smooth(rate.si)) / step)
        if slope is not None and slope > 1e-3:
            radians = slope > math.sqrt(math.pi / 180.0)
            unit = SI[name] if radians else SI[name].replace("rad", "deg")
            ratio = slope / (1.0 if radians else math.pi / 180.0)
            found[name] = guess.because(f"{of} changes at {ratio:.2g} times it", unit=unit)


def accelerations_by_gravity(found: dict[str, Guess]) -> None:
    """Level flight shows gravity: 1, 9.8 or 32 tells the unit of all three, its sign the direction of az."""
    az = found.get("az")
    level = None if az is None else float(np.median(az.values))
    unit = None
    if az is not None and level:
        scales = {"g": 1.0, "m/s^2": GRAVITY, "ft/s^2": GRAVITY / 0.3048}
        unit = az.unit or min(scales, key=lambda u: abs(math.log(abs(level) / scales[u])))
        why = f"its median is {level:.3g}, and level flight has -1 g"
        found["az"] = az.because(why, unit=unit, sign=-1 if level > 0.0 else 1)
    for name in ("ax", "ay"):
        guess = found.get(name)
        if guess is not None and guess.unit is None:
            found[name] = guess.because("as az" if unit else "no az to compare it with", unit=unit or "m/s^2")


def speed_and_height(found: dict[str, Guess]) -> None:
    """The climb: height changes by airspeed times the sine of the path angle, which tells the two units together.

    Pairs as km/h with ft and m/s with m differ there by 9 per cent only, and ft/s with ft from m/s with m by nothing:
    the airspeed at which the path turns decides, where it can be told; of pairs
    that fit alike, the more usual is taken.
    """
    speed, height = found.get("airspeed"), found.get("altitude")
    speeds = {"m/s": 1.0, "kt": 0.514444, "km/h": 1.0 / 3.6, "ft/s": 0.3048}
    heights = {"m": 1.0, "ft": 0.3048}
    slope, step = None, step_of(found)
    if step is not None and all(name in found for name in ("airspeed", "altitude", "theta", "alpha")):
        path = found["theta"].si - found["alpha"].si
        climb = np.gradient(smooth(found["altitude"].values)) / step
        if np.std(path) > 0.01:
            slope = slope_of(found["airspeed"].values * np.sin(smooth(path)), climb)
    if slope is not None and slope > 0.0 and speed is not None and height is not None:
        every = dict.fromkeys((*USUAL, *((v, h) for v in speeds for h in heights)))
        pairs = [(v, h) for v, h in every if speed.unit in (None, v) and height.unit in (None, h)]
        if pairs:
            turning, middle = turning_speed(found), float(np.median(speed.values))

            def misfit(pair: tuple[str, str]) -> float:
                v, h = speeds[pair[0]], heights[pair[1]]
                turn = 0.0 if turning is None or middle <= 0.0 else abs(math.log(middle * v / turning))
                return abs(math.log(slope * h / v)) + turn

            best = min(map(misfit, pairs))
            v, h = next(pair for pair in pairs if misfit(pair) < best + UNTOLD)
            ratio = slope * heights[h] / speeds[v]
            why = f"height changes at {ratio:.2g} times airspeed x sin(theta - alpha) in {v} and {h}"
            why += "" if turning is None else f", and az and q say {turning / speeds[v]:.2g} {v}"
            found |= {"airspeed": speed.because(why, unit=v), "altitude": height.because(why, unit=h)}
            return
    for name, unit, other in (("airspeed", "m/s", "kt"), ("calibrated_airspeed", "m/s", "kt"), ("altitude", "m", "ft")):
        guess = found.get(name)
        if guess is not None and guess.unit is None:
            found[name] = guess.because(f"nothing in the file tells {unit} from {other}", unit=unit)


def turning_speed(found: Mapping[str, Guess]) -> float | None:
    """Airspeed in m/s at which the path turns: az + g cos(theta) = V (d alpha/dt - q); None where that cannot be seen.

    Small angles and level wings.
    """
    step, names = step_of(found), ("az", "theta", "alpha", "q")
    if step is None or not all(name in found for name in names):
        return None
    az, theta, alpha, q = (smooth(found[name].si) for name in names)
    turn, normal = np.gradient(alpha) / step - q, az + GRAVITY * np.cos(theta)
    if min(np.ptp(turn), np.ptp(normal)) == 0.0 or np.corrcoef(turn, normal)[0, 1] < CLEAR:
        return None  # straight flight, or noise that would make the slope too small
    return slope_of(turn, normal)


def density_of_air(found: dict[str, Guess]) -> None:
    """Unit in which it is that of a standard atmosphere at the altitude, else what dynamic pressure and airspeed make,
    else that of some air."""
    guess, height = found.get("density"), found.get("altitude")
    speed, pressure = found.get("airspeed"), found.get("dynamic_pressure")
    middle = 0.0 if guess is None else float(np.median(guess.values))
    if guess is None or guess.unit is not None or not middle > 0.0:
        return
    rho, why = MIDDLING, "flight goes on"
    if height is not None:
        rho, why = float(np.median(standard_air(height.si)[0])), "a standard atmosphere has at the altitude"
    elif speed is not None and pressure is not None and pressure.unit is not None:
        rho = float(np.median(2.0 * pressure.si / np.maximum(speed.si, 1.0) ** 2))
        why = "dynamic pressure and airspeed make"
    units = ["kg/m^3", "slug/ft^3", "lb/ft^3", "g/m^3", *(["g/cm^3"] if height is not None else [])]
    sizes = {u: float(to_si(1.0, u, "density", "kg/m^3")) for u in units}  # slug/ft^3 and g/cm^3 are a factor 2 apart
    unit = min(sizes, key=lambda u: abs(math.log(middle * sizes[u] / max(rho, 1e-3))))
    why = f"it is {middle * sizes[unit] / max(rho, 1e-3):.2g} times what {why} in {unit}"
    found["density"] = guess.because(why, unit=unit)


def dynamic_pressure(found: dict[str, Guess]) -> None:
    """Unit in which it makes air of the recorded density, or else of some density, at the airspeed."""
    guess, speed = found.get("dynamic_pressure"), found.get("airspeed")
    if guess is None or guess.unit is not None or speed is None or speed.unit is None:
        return
    density = found.get("density")
    rho = float(np.median(density.si)) if density and density.unit else MIDDLING
    ratio = float(np.median(guess.values)) / (0.5 * rho * float(np.median(speed.si)) ** 2 or 1.0)
    if not ratio > 0.0:
        return
    sizes = {u: float(to_si(1.0, u, "dynamic_pressure", "Pa")) for u in ("Pa", "hPa", "kPa", "lbf/ft^2", "psi")}
    unit = min(sizes, key=lambda u: abs(math.log(ratio * sizes[u])))
    why = f"it is {ratio * sizes[unit]:.2g} times half of density times airspeed squared in {unit}"
    found["dynamic_pressure"] = guess.because(why, unit=unit)


def units_by_size(found: dict[str, Guess]) -> None:
    """What is left, by the size of its values."""
    for name, guess in [(name, guess) for name, guess in found.items() if guess.unit is None]:
        size, middle = largest(guess), float(np.median(guess.values))
        choices = {
            "static_temperature": ("K" if middle > 150.0 else "degC"),
            "static_pressure": ("Pa" if size > 1200.0 else "hPa"),
            **dict.fromkeys(FRACTIONS, "%" if size > 2.0 else "1"),
            **dict.fromkeys(("alpha_dot", "beta_dot"), "deg/s" if size > ANGLE else "rad/s"),
            "engine_speed": "rpm",
            "calibrated_airspeed": "m/s",
            "radio_altitude": "ft" if size > 13_000.0 else "m",
        }
        if guess.channel.startswith("thrust") and size > 300.0:
            found[name] = guess.because(f"it reaches {size:.4g}, and nothing in the file tells N from lbf")
            continue
        unit = "kN" if guess.channel.startswith("thrust") else choices.get(guess.channel, SI.get(guess.channel, "1"))
        found[name] = guess.because(f"it reaches {size:.4g}", unit=unit)


def sign_of_elevator(found: dict[str, Guess]) -> None:
    """Trailing edge down pitches the nose down: the sign that pitch acceleration shows, alpha and q accounted for."""
    step = step_of(found)
    if step is None or not all(name in found for name in ("elevator", "q", "alpha")):
        return
    elevator, q = found["elevator"], smooth(found["q"].si)
    others = np.stack([smooth(found["alpha"].si), q, np.ones_like(q)], axis=1)
    both = np.stack([smooth(elevator.si), np.gradient(q) / step], axis=1)
    own, turning = (both - others @ np.linalg.lstsq(others, both, rcond=None)[0]).T
    slope = slope_of(own, turning) if alike(own, turning, FAINT) else None  # 1/s^2 a rad
    if slope is not None:
        why = f"pitch acceleration follows it with {slope:+.2g} 1/s^2 a rad; trailing edge down positive has a minus"
        found["elevator"] = elevator.because(why, sign=-1 if slope > 0.0 else 1)


STEPS: tuple[Callable[[dict[str, Guess]], None], ...] = (
    unit_of_time, angles_by_rates, angles_by_path, angles_by_size, rates_by_angles, accelerations_of_rates,
    accelerations_by_gravity, speed_and_height, density_of_air, dynamic_pressure, units_by_size, sign_of_elevator,
)  # fmt: skip


# --- One column of an unknown file, taken for a channel, and simple measures of its values.

SI = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
FOLLOWS = 0.5  # correlation of a rate with the angle that it changes; our choice
FAINT = 0.25  # correlation beyond that of noise, within 0.2 in smoothed records of 2000 samples; our choice


@dataclass(frozen=True)
class Guess:
    """One column taken for a channel; `evidence` says why, in words."""

    channel: str
    column: RawColumn
    unit: str | None
    sign: int = 1
    evidence: str = ""

    @property
    def values(self) -> np.ndarray:
        """As in the file; the median where there is no finite number."""
        x = np.zeros(1) if self.column.values is None else self.column.values
        sound = np.isfinite(x)
        return x if sound.all() else np.where(sound, x, np.median(x[sound]) if sound.any() else 0.0)

    @property
    def si(self) -> np.ndarray:
        """In SI; in the file's numbers where the unit is not known."""
        if self.unit is None:
            return self.sign * self.values
        return self.sign * to_si(self.values, self.unit, self.channel, SI.get(self.channel))

    def because(self, text: str, **changes: object) -> Guess:
        """The guess with a change, and the reason added to the evidence."""
        return replace(self, evidence=f"{self.evidence}; {text}", **changes)  # type: ignore[arg-type]


def step_of(found: Mapping[str, Guess]) -> float | None:
    """Median sampling interval, s; None where time is of no use."""
    if "time" not in found:
        return None
    step = float(np.median(np.diff(found["time"].si)))
    return step if step > 0.0 else None


def largest(guess: Guess) -> float:
    """The largest size of a value, in the file's unit."""
    return float(np.nanmax(np.abs(guess.values)))


def smooth(x: np.ndarray) -> np.ndarray:
    """Means of nine samples, so that noise does not swamp a derivative."""
    return np.convolve(np.pad(x, 4, mode="edge"), np.full(9, 1.0 / 9.0), mode="valid")


def slope_of(x: np.ndarray, y: np.ndarray) -> float | None:
    """Least-squares slope of y over x, both without their means."""
    x, y = x - np.mean(x), y - np.mean(y)
    power = float(x @ x)
    return float(x @ y) / power if power > 0.0 else None


def alike(x: np.ndarray, y: np.ndarray, least: float = FOLLOWS) -> bool:
    """Whether one of two signals follows the other, upright or reversed: what is mostly noise tells no sign."""
    return bool(min(np.ptp(x), np.ptp(y)) > 0.0 and abs(np.corrcoef(x, y)[0, 1]) > least)
