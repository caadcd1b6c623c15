"""Flight-test inputs: their shapes, and the standard inputs, simulated from trimmed level flight.

Their excitation: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 9; Jategaonkar, *Flight Vehicle System
Identification*, 2nd ed. 2015, ch. 2. Amplitudes are our choice: those of a transport in a flight test.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from bayes_aero.dynamics.simulated.simulate import Pilot, fly_rigid, fly_together
from bayes_aero.dynamics.simulated.trim import (
    SIDE_FORCE,
    SIGNALS,
    Condition,
    FlightState,
    RigidTrim,
    Trim,
    refuse_unsimulated,
    rigid_trim,
    trimmed,
)
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import DEFAULT_RANGES, Aircraft, Envelope, excursion
from bayes_aero.flight.atmosphere import GRAVITY, air
from bayes_aero.flight.channel import Axis
from bayes_aero.model.model import Model

SECONDS = 60.0  # s, of every manoeuvre, so that one compiled function serves all
RUN_IN = 5.0  # s of simulation before the record starts
TIGHT, LOOSE = (0.7, 0.2, 0.15), (0.05, 0.0, 0.0)  # elevator gains on alpha, q and the integral of alpha
STALL_BEYOND, STALL_RISE = np.deg2rad(2.0), np.deg2rad(8.0)  # beyond alpha*, or beyond trim without separation
SETTLE, WHOLE = 3.0, 10.0  # s recorded at least after the last input, and s of which a record is a multiple
MULTISINE, MULTISINE_BAND = (5.0, 25.0, 2), (0.1, 1.4)  # begin and period, s, number of periods; Hz
ANYWHERE = Envelope()
EXCITED_CHANNELS = {"stabilizer_steps": "stabilizer", "sideslip": "beta", "bank_to_bank": "phi"}
"""Channels that a manoeuvre excites in addition to elevator and thrust."""


Series = Float[np.ndarray, " n"]
Pulse = tuple[float, float, float]  # begin and end, s, and level


def pulses(time: Series, parts: Iterable[Pulse]) -> Series:
    """Levels held from begin to end, zero between; a later part replaces an earlier one."""
    signal = np.zeros_like(time)
    for begin, end, level in parts:
        signal[(time >= begin) & (time < end)] = level
    return signal


def steps(*points: tuple[float, float]) -> list[Pulse]:
    """Pulses of levels held from each time (s) on."""
    return [(begin, np.inf, level) for begin, level in points]


def three_two_one_one(begin: float, unit: float, size: float) -> list[Pulse]:
    """Pulses of a 3-2-1-1 with `unit` s a step."""
    edges = begin + np.round(unit * np.array([0.0, 3.0, 5.0, 6.0, 7.0]), 9)  # 3 x 0.8 is not 2.4, where a sample may be
    return [(a, b, sign * size) for a, b, sign in zip(edges, edges[1:], (1.0, -1.0, 1.0, -1.0), strict=False)]


def ramps(time: Series, points: Iterable[tuple[float, float]]) -> Series:
    """Straight lines between (time s, level)."""
    return np.interp(time, *np.array(list(points)).T)


def rounded(signal: Series, seconds: float, dt: float) -> Series:
    """Convolved with a Hann window of this length, as by an actuator; held constant beyond the ends."""
    window = np.hanning(round(seconds / dt) | 1)
    window = window if len(window) > 2 else np.ones(1)
    padded = np.pad(signal, len(window) // 2, mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")


def commands(
    time: Series, trim: Trim, stall: float, bank_per_sideslip: float, amplitude: float = 1.0
) -> dict[str, Pilot]:
    """The standard inputs by name, from `trim`. `stall` (rad): rise of alpha of the slow sweep above trim;
    `bank_per_sideslip`: bank that keeps the heading. `amplitude` multiplies all inputs."""
    rest, dt, deg = np.zeros_like(time), float(time[1] - time[0]), np.pi / 180.0

    def held(parts: list[Pulse], smooth: float) -> Series:
        return rounded(amplitude * pulses(time, parts), smooth, dt)

    def pilot(
        gains: tuple[float, ...] = TIGHT, alpha: Series = rest, thrust: Series = rest, **signals: Series
    ) -> Pilot:
        """A pilot with changes from trim; thrust as a share of that in trim."""
        power = trim.thrust * np.maximum(1.0 + thrust, 0.1)
        feedback = dict(zip(("alpha_gain", "rate_gain", "trim_gain"), gains, strict=True))
        zeros = dict.fromkeys(("excitation", "phi", "beta", "stabilizer"), rest)
        return Pilot(trim.alpha + alpha, power, **zeros | feedback | signals)

    doublets = [pulse for t in (5.0, 32.0) for pulse in steps((t, 2.5 * deg), (t + 1.5, -2.5 * deg), (t + 3.0, 0.0))]
    multistep = [pulse for t in (5.0, 32.0) for pulse in three_two_one_one(t, 0.8, 2.0 * deg)]
    sideslip = held(steps((5.0, 5.0 * deg), (20.0, -5.0 * deg), (35.0, 0.0)), 4.0)
    bank = held(steps((5.0, 30 * deg), (20.0, -30 * deg), (35.0, 30 * deg), (50.0, 0.0)), 5.0)
    power = held(steps((5.0, 0.6), (18.0, -0.6), (35.0, 0.6), (48.0, 0.0)), 1.5)
    sweep = [(0.0, 0.0), (5.0, 0.0), (32.0, stall), (35.0, stall), (39.0, 0.3 * stall), (45.0, stall), (52.0, 0.0)]
    idle = amplitude * ramps(time, [(0.0, 0.0), (5.0, 0.0), (7.0, -0.6)])
    return {
        "elevator_doublet": pilot(LOOSE, excitation=held(doublets, 0.4)),
        "elevator_3211": pilot(LOOSE, excitation=held(multistep, 0.4)),
        "multisine": pilot(LOOSE, excitation=amplitude * 2.0 * deg * multisine_inputs(time, 1)[0]),
        "slow_stall": pilot(alpha=amplitude * ramps(time, sweep), thrust=idle),
        "thrust_steps": pilot(thrust=power),
        "sideslip": pilot(beta=sideslip, phi=bank_per_sideslip * sideslip),
        "bank_to_bank": pilot(phi=bank),
        "stabilizer_steps": pilot(stabilizer=held(steps((5.0, 1.0 * deg), (22.0, -1.0 * deg), (40.0, 0.0)), 2.0)),
        "speed_change": pilot(LOOSE, excitation=held(steps((5.0, 1.0 * deg), (12.0, 0.0)), 1.0)),
    }


def multisine_inputs(time: Series, controls: int) -> Float[np.ndarray, "c n"]:
    """Multisines with a peak of 1 on several controls: whole periods from `MULTISINE[0]` s on, zero elsewhere."""
    begin, period, count = MULTISINE
    inside = (time >= begin) & (time < begin + count * period)
    return np.where(inside, multisines(time - begin, period, MULTISINE_BAND, controls), 0.0)


def standard_pilots(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    time: Series,
    airspeed: float,
    altitude: float,
    amplitude: float = 1.0,
) -> tuple[dict[str, Pilot], FlightState | RigidTrim]:
    """The pilot of each manoeuvre with this model, and the level flight in which all start. `airspeed` in m/s,
    `altitude` in m. A model of both axes flies in six degrees of freedom, and the manoeuvres of `LATERAL` as well.
    Raises `InputError` where the model cannot be trimmed."""
    start: FlightState | RigidTrim
    if rigid := Axis.LATERAL in model.axes:
        start = rigid_trim(model, values, aircraft, Condition(airspeed, altitude))
        sideslipping = rigid_trim(model, values, aircraft, Condition(airspeed, altitude, sideslip=REFERENCE_SIDESLIP))
        bank_per_sideslip = (sideslipping.state["phi"] - start.state["phi"]) / REFERENCE_SIDESLIP
        trim = Trim(start.state["alpha"], start.thrust, 0.0)
    else:
        trim = trimmed(model, values, aircraft, airspeed, altitude)
        pressure = 0.5 * float(air(jnp.asarray(altitude))[0]) * airspeed**2
        bank_per_sideslip = -pressure * float(aircraft.wing_area) * SIDE_FORCE / (float(aircraft.mass) * GRAVITY)
        start = FlightState(airspeed, trim.alpha, trim.alpha, 0.0, altitude, trim=trim.command)
    stall = model.break_angle(values) + STALL_BEYOND
    rise = stall - trim.alpha if stall < DEFAULT_RANGES["alpha"][1] else STALL_RISE  # of the slow sweep, above trim
    pilots = commands(time, trim, rise, bank_per_sideslip, amplitude)
    return pilots | (lateral_commands(time, trim, pilots["slow_stall"], amplitude) if rigid else {}), start


@dataclass(frozen=True)
class StandardFlights:
    """Channels of every standard manoeuvre without noise, by name, and how many `seconds` of each are recorded;
    `refused` says why the others cannot be flown. Beside the recorded channels: `X`."""

    channels: Mapping[str, Mapping[str, np.ndarray]]
    seconds: Mapping[str, float]
    refused: Mapping[str, str]


def fly_standard(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    *,
    airspeed: float,
    altitude: float,
    dt: float,
    amplitude: float = 1.0,
    envelope: Envelope = ANYWHERE,
) -> StandardFlights:
    """Fly all of `standard_pilots`, sampled every `dt` s; a manoeuvre that leaves the `envelope` is refused."""
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    n, before = round(SECONDS / dt) + 1, round(RUN_IN / dt)
    time = (np.arange(n + before) - before) * dt
    rigid = Axis.LATERAL in model.axes
    for effect in model.acting if rigid else ():
        refuse_unsimulated(effect, SIGNALS | {"aileron", "thrust_left", "thrust_right"})
    pilots, start = standard_pilots(model, values, aircraft, time, airspeed, altitude, amplitude)
    if isinstance(start, RigidTrim):
        flights = [fly_rigid(model, values, aircraft, pilot, start, dt) for pilot in pilots.values()]
    else:
        flights = fly_together(model, values, aircraft, list(pilots.values()), [start] * len(pilots), dt)
    flown, refused = {}, {}
    for name, flight in zip(pilots, flights, strict=True):
        channels = {key: x[before:] for key, x in flight.items()}
        if left := envelope.left_by(excursion(channels)):
            refused[name] = f"it leaves its envelope: {left}"
        elif rigid:
            flown[name] = channels | {"aileron_left": -channels["aileron"], "aileron_right": channels["aileron"]}
        else:
            flown[name] = channels | {f"thrust_{side}": channels["thrust"] / 2.0 for side in ("left", "right")}
    return StandardFlights(flown, {name: until(pilots[name], time) for name in flown}, refused)


def until(pilot: Pilot, time: Series) -> float:
    """Length of the record, s, after which a pilot gives no more input and the response has been recorded."""
    signals = [np.asarray(x) for x in pilot if np.ndim(x) == 1]
    moving = [np.flatnonzero(np.abs(np.diff(x)) > 1e-9 * np.max(np.abs(x) + 1e-30)) for x in signals]
    last = max((int(at[-1]) for at in moving if len(at)), default=0)
    return float(min(WHOLE * np.ceil((max(time[last], 0.0) + SETTLE) / WHOLE), SECONDS))


# --- Orthogonal multisines on several controls at once, with a small peak for their power.
# Source: Morelli, "Multiple input design for real-time parameter estimation in the frequency domain", IFAC SYSID
# 2003; first phases: Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85; their improvement: Van der Ouderaa, Schoukens
# and Renneboog, IEEE Trans. Instrum. Meas. 37 (1988) 145.

CLIP, ROUNDS = 0.9, 300  # of the peak that a round leaves, and rounds of clipping
GRID = 16  # points for each period of the highest frequency on which the peak is sought


def multisines(
    time: Float[np.ndarray, " n"], period: float, band: tuple[float, float], controls: int
) -> Float[np.ndarray, "c n"]:
    """Multisines (c, n) with a peak of 1, zero where `time` (s) is, that share no frequency; periodic in `period` (s).
    The multiples of 1/`period` in `band` (Hz) are dealt to the `controls` in turn, so that each covers the band. Over a
    whole period the inputs are uncorrelated, and so are their derivatives and integrals."""
    k = np.arange(np.ceil(band[0] * period - 1e-9), np.floor(band[1] * period + 1e-9) + 1)
    if len(k) < 2 * controls or k[0] < 1:
        raise InputError(
            f"the band {band[0]:g} to {band[1]:g} Hz has {len(k)} multiples of 1/{period:g} s, and {controls} "
            f"multisines need {2 * controls} above zero; widen the band or lengthen the period"
        )
    signals = []
    for own in (k[number::controls] for number in range(controls)):
        phase, at = _phases(own), 2.0 * np.pi * time[:, None] / period
        fine = np.linspace(0.0, 2.0 * np.pi, GRID * int(own[-1]) * 4)
        whole = np.sum(np.cos(fine[:, None] * own + phase), axis=1)
        crossing = int(np.argmax(np.diff(np.sign(whole)) != 0.0))
        sum_at = lambda angle, own, phase: float(np.sum(np.cos(angle * own + phase)))  # noqa: E731
        zero: Any = brentq(sum_at, *fine[crossing : crossing + 2], args=(own, phase))
        signals.append(np.sum(np.cos((at + zero) * own + phase), axis=1) / np.max(np.abs(whole)))
    return np.stack(signals)


def _phases(k: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Phases with a small peak: Schroeder's, then the phases of the clipped signal, again and again."""
    order = np.arange(len(k))
    phase = -np.pi * order * (order + 1) / len(k)
    angle = np.linspace(0.0, 2.0 * np.pi, GRID * int(k[-1]), endpoint=False)
    basis = np.exp(1j * np.outer(k, angle))
    best, least = phase, np.inf
    for _ in range(ROUNDS):
        signal = np.real(np.exp(1j * phase) @ basis)
        peak = np.max(np.abs(signal))
        if peak < least:
            best, least = phase, peak
        phase = np.angle(basis.conj() @ np.clip(signal, -CLIP * peak, CLIP * peak))
    return best


# --- The standard inputs of the lateral axis.

LATERAL = ("aileron_doublet", "rudder_doublet", "stall_with_bank", "engine_steps")
REFERENCE_SIDESLIP = 0.05  # rad, of the steady sideslip that gives the bank per sideslip
AILERON, RUDDER = np.deg2rad(5.0), np.deg2rad(3.0)  # amplitudes of a transport in a flight test; our choice
BANK, UNEVEN = np.deg2rad(15.0), 0.3  # in the stall; of the left engine's thrust less the right one's over their sum
LATERAL_EXCITED_CHANNELS = {  # channels that each manoeuvre excites, in addition to `manoeuvres.EXCITED_CHANNELS`
    "aileron_doublet": "aileron", "rudder_doublet": "rudder", "engine_steps": "thrust_left", "multisine": "aileron",
}  # fmt: skip


def lateral_commands(time: Series, trim: Trim, stalling: Pilot, amplitude: float = 1.0) -> dict[str, Pilot]:
    """Doublets of aileron and rudder, multisines of these and the elevator, a stall in banked flight, unequal
    engines."""
    dt = float(time[1] - time[0])

    def doublets(size: float) -> Series:
        parts = []
        for begin, unit in ((5.0, 1.0), (20.0, 2.0), (40.0, 1.0)):
            parts += steps((begin, size), (begin + unit, -size), (begin + 2.0 * unit, 0.0))
        return rounded(amplitude * pulses(time, parts), 0.4, dt)

    def held(smooth: float, *points: tuple[float, float]) -> Series:
        return rounded(amplitude * pulses(time, steps(*points)), smooth, dt)

    zeros, (elevator, aileron, rudder) = np.zeros_like(time), amplitude * multisine_inputs(time, 3)
    level = Pilot(trim.alpha + zeros, trim.thrust + zeros, alpha_gain=0.05, rate_gain=0.0)
    return {
        "aileron_doublet": level._replace(aileron=doublets(AILERON)),
        "rudder_doublet": level._replace(rudder=doublets(RUDDER)),
        "multisine": level._replace(
            excitation=np.deg2rad(2.0) * elevator, aileron=AILERON * aileron, rudder=RUDDER * rudder
        ),
        "stall_with_bank": stalling._replace(phi=held(4.0, (10.0, BANK), (25.0, -BANK), (41.0, BANK), (52.0, 0.0))),
        "engine_steps": level._replace(uneven=held(1.5, (5.0, UNEVEN), (20.0, -UNEVEN), (35.0, UNEVEN), (50.0, 0.0))),
    }
