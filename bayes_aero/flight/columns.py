"""Guess what the columns of an unknown file are: names from headings, units and signs from the values' own physics.

Nothing here is certain, and every guess carries its evidence: it is meant to be read by a person.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

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
DEGREE = math.pi / 180.0
ANGLES, RATES = {"rad": 1.0, "deg": DEGREE}, {"rad/s": 1.0, "deg/s": DEGREE}
SPEEDS = {"m/s": 1.0, "kt": 0.514444, "km/h": 1.0 / 3.6, "ft/s": 0.3048}
HEIGHTS = {"m": 1.0, "ft": 0.3048}
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


Guesses = dict[str, Guess]


def guessed(columns: Sequence[RawColumn]) -> tuple[Guesses, list[RawColumn]]:
    """Channels by name, and the columns that remain unknown."""
    guesses: Guesses = {}
    unknown = []
    for loose in (False, True):  # exact names first, so that a resemblance never takes a place
        for column in columns:
            if any(guess.column is column for guess in guesses.values()):
                continue
            guess = _named(column, loose)
            if guess is not None and guess.channel not in guesses:
                guesses[guess.channel] = guess
            elif loose:
                unknown.append(column)
    for take in STEPS:
        take(guesses)
    return guesses, unknown


def _named(column: RawColumn, loose: bool) -> Guess | None:
    """By the first of its names that says something; files with two rows of names have two."""
    if column.label is None or column.values is None:
        return None
    names = dict.fromkeys((column.label, *column.heading.names))
    return next((guess for name in names if (guess := _called(column, name, loose)) is not None), None)


def _called(column: RawColumn, name: str, loose: bool) -> Guess | None:
    heading, evidence, symbol = name, f"the heading {name!r}", None
    channel = ALIASES.get(split_heading(name)[0])
    if channel is None:
        heading = plain_heading(name)
        channel = ALIASES.get(split_heading(heading)[0])
    key = split_heading(heading)[0]
    if channel is None and (sided := side_of(name)) is not None:
        channel = f"{ALIASES.get(split_heading(sided[0])[0])}_{sided[1]}"
        channel = channel if channel in SI else None
        heading, evidence = (sided[0], f"{evidence}, the {sided[1]} one") if channel else (heading, evidence)
    if channel is None and loose and len(key) > 3 and not is_command(name):
        if close := get_close_matches(key, ALIASES, n=1, cutoff=ALIKE):
            channel, evidence = ALIASES[close[0]], f"{evidence} resembles {close[0]!r}"
        if sided is not None and f"{channel}_{sided[1]}" in SI:
            channel = f"{channel}_{sided[1]}"  # one of two, not the whole
    if channel is None and loose and (symbol := symbol_of(name)) is not None:
        channel, evidence = ALIASES[symbol], f"{evidence} ends with {symbol!r}"
    if channel is None:
        return None
    si = SI.get(channel)
    stated = [column.unit, split_heading(heading, si)[1], split_heading(symbol, si)[1] if symbol else None]
    for unit in (canonical(unit, si) for unit in stated if unit):
        with suppress(ValueError):  # values in this unit cannot be the channel
            if unit:
                to_si(0.0, unit, channel, si)
                return Guess(channel, column, unit, evidence=f"{evidence} and its unit {unit}")
    return Guess(channel, column, None, evidence=evidence)


# --- The steps, in their order: each changes guesses by what the values of others say.

Step = Callable[[Guesses], None]
STEPS: list[Step] = []


def step(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A step that is taken where all of these were found; "dt" is the interval, s, of a time that is of use."""

    def of(do: Callable[..., None]) -> Callable[..., None]:
        def take(guesses: Guesses) -> None:
            time = guesses.get("time")
            dt = None if time is None else float(np.median(np.diff(time.si)))
            given = [(dt if dt and dt > 0.0 else None) if name == "dt" else guesses.get(name) for name in names]
            if None not in given:
                do(guesses, *given)

        STEPS.append(take)
        return do

    return of


def state(guesses: Guesses, guess: Guess, why: str, **changes: Any) -> None:
    guesses[guess.channel] = replace(guess, evidence=f"{guess.evidence}; {why}", **changes)


def largest(guess: Guess) -> float:
    return float(np.nanmax(np.abs(guess.values)))


def smooth(x: np.ndarray) -> np.ndarray:
    """Means of nine samples, so that noise does not swamp a derivative."""
    return np.convolve(np.pad(x, 4, mode="edge"), np.full(9, 1.0 / 9.0), mode="valid")


def slope_of(x: np.ndarray, y: np.ndarray, least: float = FOLLOWS) -> float:
    """Least-squares slope of y over x, where one follows the other, upright or reversed; 0 where noise rules."""
    x, y = x - np.mean(x), y - np.mean(y)
    if min(np.ptp(x), np.ptp(y)) == 0.0 or not abs(np.corrcoef(x, y)[0, 1]) > least:
        return 0.0
    return float(x @ y) / float(x @ x)


def choose(guesses: Guesses, guess: Guess, ratio: float, sizes: Mapping[str, float], what: str, **changes: Any) -> None:
    """The unit, of these SI `sizes`, in which values are as `what` says; `ratio`: of the values to that, in SI."""
    if abs(ratio) > 1e-6:
        unit = guess.unit or min(sizes, key=lambda unit: abs(math.log(abs(ratio) * sizes[unit])))
        size = sizes.get(unit, 1.0)
        state(guesses, guess, f"it is {ratio * size:.2g} times what {what} in {unit}", unit=unit, **changes)


@step("time")
def unit_of_time(guesses: Guesses, time: Guess) -> None:
    if time.unit is None:
        dt = float(np.median(np.diff(time.values)))
        state(guesses, time, f"its median step is {dt:.6g}", unit="ms" if dt > 2.0 else "s")


@step("dt", "p", "phi")
@step("dt", "q", "theta")
def angle_by_rate(guesses: Guesses, dt: float, rate: Guess, angle: Guess) -> None:
    """An attitude changes as its rate says, which tells their units apart; where neither is stated, if they differ."""
    slope = slope_of(smooth(rate.si), np.gradient(smooth(angle.values)) / dt) if angle.unit is None else 0.0
    if rate.unit is not None:
        choose(guesses, angle, slope, ANGLES, f"{rate.channel} makes")
    elif slope and abs(math.log(abs(slope))) > math.log(BETWEEN):
        choose(guesses, angle, slope, ANGLES, f"{rate.channel} makes")
        unit = "rad/s" if abs(slope) > BETWEEN else "deg/s"
        state(guesses, rate, f"{angle.channel} changes at {abs(slope):.2g} times it", unit=unit)


@step("dt", "theta", "alpha", "airspeed", "altitude")
def angles_by_path(guesses: Guesses, dt: float, theta: Guess, alpha: Guess, speed: Guess, height: Guess) -> None:
    """Pitch attitude less angle of attack is the angle of the path, as climb and airspeed of stated units make it."""
    missing = [g for g in (theta, alpha) if g.unit is None]
    if not missing or speed.unit is None or height.unit is None:
        return
    path = np.arcsin(np.clip(np.gradient(smooth(height.si)) / dt / np.maximum(smooth(speed.si), 1.0), -1.0, 1.0))
    recorded, meant = theta.values - alpha.values, path
    if len(missing) == 1:
        recorded, meant = (theta.values, alpha.si + path) if theta.unit is None else (alpha.values, theta.si - path)
    slope = slope_of(smooth(meant), smooth(recorded))
    for guess in missing:
        choose(guesses, guess, max(slope, 0.0), ANGLES, "the climb makes of theta - alpha")


@step()
def angles_by_size(guesses: Guesses) -> None:
    """Beyond 1.6 it can only be degrees, a heading or bank beyond a turn; smaller ones go with the rest of the file, of
    which a heading, from another instrument, tells only where others are large, too."""
    angles = {name: g for name, g in guesses.items() if SI.get(name) == "rad"}
    missing = {name: largest(g) for name, g in angles.items() if g.unit is None}
    large = [n for n, size in missing.items() if size > (TURN if n in TURNING else ANGLE)]
    others = max((size for n, size in missing.items() if n not in TURNING), default=0.0)
    stated = {g.unit for g in angles.values()} - {None}
    degrees = any(n != "psi" for n in large) or (bool(large) and others > STEEP) or stated == {"deg"}
    for name, size in missing.items():
        beside = ", and other angles of the file are in degrees" if degrees else ", too little for degrees"
        why = f"it reaches {size:.3g}{'' if name in large else beside}"
        state(guesses, angles[name], why, unit="deg" if degrees or name in large else "rad")


@step("dt", "p", "phi")
@step("dt", "q", "theta")
def rate_by_angle(guesses: Guesses, dt: float, rate: Guess, angle: Guess) -> None:
    """Unit and sign of a rate from the attitude that it changes."""
    slope = slope_of(np.gradient(smooth(np.unwrap(angle.si))) / dt, smooth(rate.values))
    choose(guesses, rate, slope, RATES, f"the change of {angle.channel} is", sign=1 if slope > 0.0 else -1)


@step("dt", "r")
def yaw_rate(guesses: Guesses, dt: float, guess: Guess) -> None:
    """Unit of the yaw rate from the heading, r = psi' cos(theta) cos(phi) - theta' sin(phi), else from the bank of a
    turn, r = g sin(phi) cos(theta) / V: no unit of airspeed is as far from another as degrees are from radians."""
    zero = np.zeros(len(guess.values))
    phi, theta = (guesses[name].si if name in guesses else zero for name in ("phi", "theta"))
    ways = {}
    if "psi" in guesses:
        psi, pitching = np.gradient(smooth(np.unwrap(guesses["psi"].si))) / dt, np.gradient(smooth(theta)) / dt
        ways["heading"] = psi * np.cos(theta) * np.cos(phi) - pitching * np.sin(phi)
    if "airspeed" in guesses and "phi" in guesses:
        ways["bank"] = GRAVITY * np.sin(phi) * np.cos(theta) / np.maximum(guesses["airspeed"].values, 1.0)
    for of, turning in ways.items():
        if guesses["r"].unit is None:
            choose(guesses, guess, slope_of(turning, smooth(guess.values)), RATES, f"the {of} makes")


@step()
def other_rates(guesses: Guesses) -> None:
    """What no attitude tells goes with the other rates: one instrument gives all three, but perhaps the yaw rate."""
    rates = [guesses[name] for name in ("p", "q", "r") if name in guesses]
    stated = [guess for guess in rates if guess.unit is not None]
    units = {guess.unit: guess.channel for guess in stated if guess.channel != "r" or len(stated) == 1}
    reach = max((largest(guess) for guess in rates), default=0.0)
    angles = [g.unit for name, g in guesses.items() if SI.get(name) == "rad"]
    for guess in (guess for guess in rates if guess.unit is None):
        if len(units) == 1 and (largest(guess) <= FASTEST or "deg/s" in units):
            unit, beside = next(iter(units.items()))
            state(guesses, guess, f"as {beside}", unit=unit)
        else:
            size = largest(guess) if units else reach  # what differs from the others is judged by itself
            degrees = size > ANGLE or (not units and angles.count("deg") > len(angles) / 2)
            state(guesses, guess, f"the rates reach {reach:.3g}", unit="deg/s" if degrees else "rad/s")


@step("dt", "p_dot", "p")
@step("dt", "q_dot", "q")
@step("dt", "r_dot", "r")
@step("dt", "alpha_dot", "alpha")
@step("dt", "beta_dot", "beta")
def unit_of_derivative(guesses: Guesses, dt: float, guess: Guess, of: Guess) -> None:
    """An angular acceleration, or the rate of an angle, from what it changes."""
    slope = slope_of(np.gradient(smooth(of.si)) / dt, smooth(guess.values), 0.0)
    if guess.unit is None and slope > 0.0:
        unit = SI[guess.channel]
        choose(guesses, guess, slope, {unit: 1.0, unit.replace("rad", "deg"): DEGREE}, f"the change of {of.channel} is")


@step("az")
def vertical_acceleration(guesses: Guesses, az: Guess) -> None:
    """Level flight shows gravity: 1, 9.8 or 32 tells the unit, its sign the direction."""
    level = float(np.median(az.values)) / -GRAVITY
    sizes = {"g": GRAVITY, "m/s^2": 1.0, "ft/s^2": 0.3048}
    choose(guesses, az, level, sizes, "level flight has", sign=-1 if level < 0.0 else 1)


@step()
def other_accelerations(guesses: Guesses) -> None:
    unit = guesses["az"].unit if "az" in guesses else None
    for guess in (guesses[name] for name in ("ax", "ay") if name in guesses):
        if guess.unit is None:
            state(guesses, guess, "as az" if unit else "no az to compare it with", unit=unit or "m/s^2")


@step("dt", "airspeed", "altitude", "theta", "alpha")
def speed_and_height(guesses: Guesses, dt: float, speed: Guess, height: Guess, theta: Guess, alpha: Guess) -> None:
    """Height changes by airspeed times the sine of the path angle, which tells the two units together. Of pairs that
    are alike there, the airspeed at which the path turns decides, where it can be told; else the usual one is taken."""
    path, climb = theta.si - alpha.si, np.gradient(smooth(height.values)) / dt
    slope = slope_of(speed.values * np.sin(smooth(path)), climb, 0.0) if np.std(path) > 0.01 else 0.0
    every = dict.fromkeys((*USUAL, *((v, h) for v in SPEEDS for h in HEIGHTS)))
    pairs = [(v, h) for v, h in every if speed.unit in (None, v) and height.unit in (None, h)]
    if slope <= 0.0 or not pairs:
        return
    # Where the path turns, az + g cos(theta) = V (d alpha/dt - q), for small angles and level wings.
    turning, middle = 0.0, float(np.median(speed.values))
    if "az" in guesses and "q" in guesses and middle > 0.0:
        turn = np.gradient(smooth(alpha.si)) / dt - smooth(guesses["q"].si)
        turning = slope_of(turn, smooth(guesses["az"].si) + GRAVITY * np.cos(smooth(theta.si)), CLEAR)

    def misfit(pair: tuple[str, str]) -> float:
        v, h = SPEEDS[pair[0]], HEIGHTS[pair[1]]
        return abs(math.log(slope * h / v)) + (abs(math.log(middle * v / turning)) if turning > 0.0 else 0.0)

    v, h = next(pair for pair in pairs if misfit(pair) < min(map(misfit, pairs)) + UNTOLD)
    ratio = slope * HEIGHTS[h] / SPEEDS[v]
    why = f"height changes at {ratio:.2g} times airspeed x sin(theta - alpha) in {v} and {h}"
    why += "" if turning <= 0.0 else f", and az and q say {turning / SPEEDS[v]:.2g} {v}"
    state(guesses, speed, why, unit=v)
    state(guesses, height, why, unit=h)


@step()
def other_speeds(guesses: Guesses) -> None:
    for name, unit, other in (("airspeed", "m/s", "kt"), ("calibrated_airspeed", "m/s", "kt"), ("altitude", "m", "ft")):
        if name in guesses and guesses[name].unit is None:
            state(guesses, guesses[name], f"nothing in the file tells {unit} from {other}", unit=unit)


@step("density")
def density_of_air(guesses: Guesses, guess: Guess) -> None:
    """Unit in which it is that of a standard atmosphere at the altitude, else that of some air."""
    height = guesses.get("altitude")
    rho = MIDDLING if height is None else float(np.median(standard_air(height.si)[0]))
    units = ["kg/m^3", "slug/ft^3", "lb/ft^3", "g/m^3", *(["g/cm^3"] if height is not None else [])]
    sizes = {u: float(to_si(1.0, u, "density", "kg/m^3")) for u in units}  # two of them are a factor 2 apart
    ratio = float(np.median(guess.values)) / max(rho, 1e-3)
    if guess.unit is None and ratio > 0.0:
        choose(guesses, guess, ratio, sizes, "air has")


@step("dynamic_pressure", "airspeed")
def dynamic_pressure(guesses: Guesses, guess: Guess, speed: Guess) -> None:
    """Unit in which it makes air of the recorded density, or else of some density, at the airspeed."""
    density = guesses.get("density")
    rho = float(np.median(density.si)) if density and density.unit else MIDDLING
    ratio = float(np.median(guess.values)) / (0.5 * rho * float(np.median(speed.si)) ** 2 or 1.0)
    if guess.unit is None and ratio > 0.0:
        sizes = {u: float(to_si(1.0, u, "dynamic_pressure", "Pa")) for u in ("Pa", "hPa", "kPa", "lbf/ft^2", "psi")}
        choose(guesses, guess, ratio, sizes, "density and airspeed make")


@step()
def units_by_size(guesses: Guesses) -> None:
    """What is left, by the size of its values."""
    for guess in [guess for guess in guesses.values() if guess.unit is None]:
        size, middle = largest(guess), float(np.median(guess.values))
        choices = {
            "static_temperature": ("K" if middle > 150.0 else "degC"),
            "static_pressure": ("Pa" if size > 1200.0 else "hPa"),
            **dict.fromkeys(FRACTIONS, "%" if size > 2.0 else "1"),
            **dict.fromkeys(("alpha_dot", "beta_dot"), "deg/s" if size > ANGLE else "rad/s"),
            "engine_speed": "rpm",
            "radio_altitude": "ft" if size > 13_000.0 else "m",
        }
        if not guess.channel.startswith("thrust"):
            unit = choices.get(guess.channel, SI.get(guess.channel, "1"))
            state(guesses, guess, f"it reaches {size:.4g}", unit=unit)
        elif size > 300.0:
            state(guesses, guess, f"it reaches {size:.4g}, and nothing in the file tells N from lbf")
        else:
            state(guesses, guess, f"it reaches {size:.4g}", unit="kN")


@step("dt", "elevator", "q", "alpha")
def sign_of_elevator(guesses: Guesses, dt: float, elevator: Guess, q: Guess, alpha: Guess) -> None:
    """Trailing edge down pitches the nose down: the sign that pitch acceleration shows, alpha and q accounted for."""
    rate = smooth(q.si)
    others = np.stack([smooth(alpha.si), rate, np.ones_like(rate)], axis=1)
    both = np.stack([smooth(elevator.si), np.gradient(rate) / dt], axis=1)
    moved, turning = (both - others @ np.linalg.lstsq(others, both, rcond=None)[0]).T
    slope = slope_of(moved, turning, FAINT)  # 1/s^2 a rad
    if slope:
        why = f"pitch acceleration follows it with {slope:+.2g} 1/s^2 a rad; trailing edge down positive has a minus"
        state(guesses, elevator, why, sign=-1 if slope > 0.0 else 1)
