"""Simulated stall manoeuvres: those of the demo, and any manoeuvre that is asked for."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from bayes_aero.dynamics.pilot import (
    LATERAL,
    FlightState,
    Pilot,
    Series,
    fly,
    pulses,
    ramps,
    rounded,
    three_two_one_one,
)
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import NAMES, Axis
from bayes_aero.simulate import Manoeuvre, SimulatedNoise

SEED = 20150101
DURATION = 90.0  # s
RECORDS = ("demo_stall_1", "demo_stall_2")

TRUTH: dict[str, float] = {  # parameters of the simulated aircraft: round numbers near those of a small transport
    "CL0": 0.15, "CLa": 3.6, "CLaM": 7.0, "Cm0": 0.06, "Cma": -0.35, "Cmq": -8.0, "Cmde": -0.70, "CD0": 0.045,
    "e": 0.85, "CDX": 0.10, "CmX": -0.10, "a1": 25.0, "alpha_star": 0.27, "tau1": 0.0, "tau2": 20.0,
}  # fmt: skip

LATERAL_TRUTH: dict[str, float] = {
    "CYbe": -0.75, "CYr": 0.3, "CYdr": 0.2, "Clbe": -0.1, "Clp": -0.45, "Clr": 0.15, "Clda": -0.12, "Cldr": 0.02,
    "Cnbe": 0.13, "Cnp": -0.06, "Cnr": -0.2, "Cnda": 0.01, "Cndr": -0.09,
}  # fmt: skip
"""The same of its lateral derivatives, for cards that model the lateral axis; rates by b/2V."""

LATERAL_EFFECTS = (  # the effects that own them
    "sideslip_side_force", "yaw_rate_side_force", "rudder_side_force", "sideslip_roll", "roll_damping", "yaw_rate_roll",
    "aileron_roll", "rudder_roll", "sideslip_yaw", "roll_rate_yaw", "yaw_damping", "aileron_yaw", "rudder_yaw",
)  # fmt: skip

SPREAD, USUAL_SPREAD = {"alpha_star": 0.08, "e": 0.10}, 0.12
"""Of aircraft drawn near it: relative, either way; the usual one of parameters that are not listed."""

DISTURBANCE = {  # turbulence and the like: first-order autoregressive increments of the coefficients
    "sigma_CL": 0.012, "sigma_CD": 0.003, "sigma_Cm": 0.001, "rho_CL": 0.5, "rho_CD": 0.3, "rho_Cm": 0.8,
}  # fmt: skip

PROFILES = (
    ((0, 6), (10, 6), (40, 15), (44, 17), (47, 11), (54, 16.5), (58, 12), (66, 17.5), (70, 8), (90, 6)),
    ((0, 7), (8, 6), (30, 14), (35, 17.5), (39, 12), (46, 17), (50, 10), (58, 16), (61, 17), (66, 7), (90, 5)),
)
"""Of alpha: slow approach to the stall, then excursions past it; straight lines between (time s, alpha deg)."""

RECORDED = (  # channels of the record beside the engines' thrust, in the order in which their noise is drawn
    "ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "airspeed", "altitude", "elevator", "mach",
    "density",
)  # fmt: skip


def simulate_stall(
    number: int, *, card: Card | None = None, seed: int = SEED, sensor_noise: float = 1.0, disturbance: float = 1.0
) -> FlightRecord:
    """Manoeuvre 0 or 1 of the recipe; `sensor_noise` and `disturbance` scale what the card and the recipe state."""
    card = card or read_card("attas")
    model = Model.of(card.effects)
    rng = np.random.default_rng([seed, number])
    time = np.arange(round(DURATION / DT) + 1) * DT
    white = rng.standard_normal((len(time), 3))
    increments = autoregressive(white, *([DISTURBANCE[f"{x}_{c}"] for c in NAMES] for x in ("rho", "sigma")))
    begins = np.sort(rng.uniform(5.0, DURATION - 10.0, 4))
    excitation = pulses(time, [part for begin in begins for part in three_two_one_one(begin, 0.8, np.deg2rad(1.5))])
    power = [(0, CRUISE), (5, CRUISE), (8, IDLE), (DURATION - 20, IDLE), (DURATION - 14, CRUISE)]
    pilot = Pilot(
        alpha=np.deg2rad(ramps(time, PROFILES[number])),
        thrust=ramps(time, power),
        excitation=rounded(excitation, 0.4, DT),
        disturbance=disturbance * increments,
    )
    alpha = float(pilot.alpha[0])
    (flight,) = fly(model, TRUTH, card.aircraft, [pilot], [FlightState(95.0, alpha, alpha, 0.0, 5200.0)], DT)
    flown = {name: flight[name] for name in (*RECORDED, "thrust_left", "thrust_right")}
    channels = {
        name: x + sensor_noise * card.sensors.get(name, 0.0) * rng.standard_normal(len(time))
        for name, x in flown.items()
    }
    return FlightRecord.from_arrays(name=RECORDS[number], time=time, channels=channels, source="simulated")


def demo_records() -> list[FlightRecord]:
    return [simulate_stall(number) for number in range(len(RECORDS))]


# --- Random stall manoeuvres of the demo's kind, with banks, sideslip and steps of thrust and stabilizer.

DT = 0.04  # s
LONGEST = 100.0  # s
MARGIN = 50  # samples flown before and after the record, for what reaches across its ends (delays)
SAMPLES = round(LONGEST / DT) + 1 + 2 * MARGIN
IDLE, CRUISE = 5_000.0, 22_000.0  # N
SURFACES = ("rudder", "spoiler", "dlc", "flap")
DEFLECTIONS = {"rudder": (3.0, True), "spoiler": (15.0, False), "dlc": (10.0, True), "flap": (14.0, False)}
"""Greatest deflection in deg, and whether to either side."""


def flight_time() -> Series:
    """Time of every sample flown in s; the record begins at 0."""
    return (np.arange(SAMPLES) - MARGIN) * DT


def random_pilot(rng: np.random.Generator, duration: float, stall: float, moved: Collection[str]) -> Pilot:
    """One manoeuvre of `duration` s at random, into a stall at alpha `stall` (rad), at the samples of `flight_time`. Of
    `SURFACES` only those in `moved` are deflected."""
    time = flight_time()
    surfaces = {name: _pulses(time, rng, duration, 3, *DEFLECTIONS[name]) for name in SURFACES}  # drawn in any case
    alpha, thrust = _alpha(time, rng, duration, np.rad2deg(stall)), _thrust(time, rng, duration)
    parts = []
    for begin in np.sort(rng.uniform(4.0, duration - 10.0, 4)):
        unit, size = rng.uniform(0.6, 1.0), np.deg2rad(rng.uniform(1.0, 2.0)) * rng.choice([-1.0, 1.0])
        parts += three_two_one_one(begin, unit, size)
    banks = _banks(time, rng, duration)
    sideslips = _pulses(time, rng, duration, int(rng.integers(2, 4)), 5.0, True)
    stabilizer = np.full_like(time, rng.uniform(-1.0, 1.0))  # deg
    for begin in rng.uniform(6.0, duration - 10.0, rng.integers(2, 4)):
        stabilizer[time >= begin] += rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0)
    return Pilot(
        alpha=alpha,
        thrust=thrust,
        excitation=rounded(pulses(time, parts), 0.4, DT),
        phi=banks,
        beta=rounded(sideslips, 2.0, DT),
        stabilizer=rounded(np.deg2rad(stabilizer), 2.0, DT),
        trim_gain=0.15,
        **{name: x if name in moved else np.zeros_like(time) for name, x in surfaces.items()},
    )


def resampled(pilot: Pilot, time: Series) -> Pilot:
    """A pilot of `random_pilot` at other samples; what is differentiated stays smooth."""
    drawn_at = flight_time()
    smooth = {name: CubicSpline(drawn_at, getattr(pilot, name))(time) for name in ("phi", "beta")}
    rows = {n: np.interp(time, drawn_at, x) for n, x in pilot._asdict().items() if np.ndim(x) and n not in smooth}
    return pilot._replace(**smooth, **rows)


def moved_by(effects: Iterable[Effect]) -> list[str]:
    needed = {channel for effect in effects for channel in effect.channels}
    return [name for name in SURFACES if {name, f"{name}_left"} & needed]


def autoregressive(white: Float[np.ndarray, "n 3"], rho: Iterable[float], sigma: Iterable[float]) -> np.ndarray:
    """Disturbances of CL, CD, Cm (n, 3) with lag-1 correlations `rho`, stationary from the first sample."""

    def series(x: Series, r: float, s: float) -> Series:
        drive = np.concatenate([x[:1], np.sqrt(1.0 - r**2) * x[1:]])
        return s * np.asarray(lfilter([1.0], [1.0, -r], drive))

    return np.stack([series(*row) for row in zip(white.T, rho, sigma, strict=True)], axis=1)


def _alpha(time: Series, rng: np.random.Generator, duration: float, stall: float) -> Series:
    """Slow approach to the stall, then two or three excursions past it, in rad: straight lines. `stall` in deg."""
    points = [(0.0, rng.uniform(5.5, 7.0)), (rng.uniform(7.0, 12.0), rng.uniform(5.5, 7.0))]
    t = rng.uniform(28.0, 40.0)
    points.append((t, stall + rng.uniform(-1.5, 0.0)))
    for _ in range(rng.integers(2, 4)):
        t += rng.uniform(3.0, 5.0)
        points.append((t, stall + rng.uniform(0.5, 2.5)))
        t += rng.uniform(3.0, 5.0)
        points.append((t, rng.uniform(10.0, 13.0)))
        t += rng.uniform(5.0, 8.0)
        points.append((t, stall + rng.uniform(-1.0, 1.0)))
    t += rng.uniform(8.0, 14.0)
    points += [(t, rng.uniform(7.5, 9.0)), (max(t + 8.0, duration), rng.uniform(5.5, 7.5))]
    return np.deg2rad(ramps(time, points))


def _thrust(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Cruise, idle with one or two bursts of power, cruise; N, each change within one to three seconds."""
    points, t = [(0.0, CRUISE)], rng.uniform(4.0, 7.0)
    points += [(t, CRUISE), (t + rng.uniform(1.0, 3.0), IDLE)]
    t = rng.uniform(14.0, 20.0)
    for _ in range(rng.integers(1, 3)):
        power = IDLE + rng.uniform(0.4, 1.0) * (CRUISE - IDLE)
        rise, hold, fall = rng.uniform(1.0, 3.0), rng.uniform(4.0, 8.0), rng.uniform(1.0, 3.0)
        points += [(t, IDLE), (t + rise, power), (t + rise + hold, power), (t + rise + hold + fall, IDLE)]
        t += rise + hold + fall + rng.uniform(8.0, 22.0)
    t = duration - rng.uniform(14.0, 20.0)
    points += [(t, IDLE), (t + rng.uniform(1.0, 3.0), CRUISE)]
    return ramps(time, points)


def _banks(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Bank to bank, up to 30 deg either way, with wings level in between; rad."""
    points, t, side = [(0.0, 0.0)], rng.uniform(4.0, 12.0), rng.choice([-1.0, 1.0])
    while t < duration - 16.0:
        for sign in (side, -side):
            angle = sign * rng.uniform(12.0, 30.0)
            points += [(t, points[-1][1]), (t + 0.1, angle)]
            t += rng.uniform(5.0, 9.0)
        points += [(t, points[-1][1]), (t + 0.1, 0.0)]
        t += rng.uniform(6.0, 18.0)
    return rounded(np.deg2rad(ramps(time, points)), 5.0, DT)


def _pulses(
    time: Series, rng: np.random.Generator, duration: float, count: int, degrees: float, either: bool
) -> Series:
    """Deflections held for some seconds at random times, `either` side in turn or one side only; rad."""
    parts = []
    for slot in range(count):  # one to each share of the record, so that none hides another
        share = (duration - 20.0) / count
        begin = 6.0 + slot * share + rng.uniform(0.0, 0.4) * share
        hold, size = rng.uniform(2.5, 4.0), np.deg2rad(degrees) * rng.uniform(0.6, 1.0)
        sign = rng.choice([-1.0, 1.0]) if either else 1.0
        parts.append((begin, begin + hold, sign * size))
        if either:
            parts.append((begin + hold, begin + 2.0 * hold, -sign * size))
    return rounded(pulses(time, parts), 1.0, DT)


# --- A synthetic record as it is asked for: what may be asked, and the samples that it takes.

NOISES, MANOEUVRES = get_args(SimulatedNoise), get_args(Manoeuvre)
RANDOM_STALL = "random_stall"
SECONDS = {RANDOM_STALL: 90.0}
USUAL_SECONDS = 60.0
SHORTEST, MOST_SAMPLES = 5.0, 200_000
BUFFET = 2.0  # growth of the disturbance with 1 - X
BEFORE, AFTER = 5.0, 2.0  # s flown beyond both ends: to settle, and for what reaches across them


@dataclass(frozen=True)
class Request:
    """What to simulate: `effects` by name with true values (SI), the manoeuvre, its noise and sampling (s). `amplitude`
    multiplies the inputs of a standard manoeuvre."""

    effects: Mapping[str, Mapping[str, float]]
    manoeuvre: str = RANDOM_STALL
    noise: str = "ar1"
    noise_scale: float = 1.0
    seed: int = 0
    duration: float | None = None
    dt: float = DT
    airspeed: float | None = None
    altitude: float = 5200.0
    amplitude: float = 1.0

    @property
    def disturbance(self) -> float:
        """Of the coefficients, over that of the demo."""
        return self.noise_scale if self.noise in ("ar1", "buffet") else 0.0

    @property
    def buffet(self) -> float:
        """Growth of the disturbance with 1 - X."""
        return BUFFET if self.noise == "buffet" else 0.0

    @property
    def seconds(self) -> float:
        return self.duration or SECONDS.get(self.manoeuvre, USUAL_SECONDS)


def refuse(request: Request, card: Card) -> None:
    if card.linear is not None:
        raise InputError(f"card {card.name} states a linear system; simulate flies cards with [aircraft] and [model]")
    if request.manoeuvre not in MANOEUVRES:
        raise InputError(f"there is no manoeuvre {request.manoeuvre!r}; use one of {', '.join(MANOEUVRES)}")
    if request.manoeuvre in LATERAL and Axis.LATERAL not in card.axes:
        raise InputError(f"a {request.manoeuvre} needs the lateral axis; add it to [model] axes of card {card.name}")
    if request.noise not in NOISES:
        raise InputError(f"there is no noise {request.noise!r}; use one of {', '.join(NOISES)}")
    most = LONGEST if request.manoeuvre == RANDOM_STALL else MOST_SAMPLES * request.dt
    for what, value, low, high, unit in (
        ("sampling interval", request.dt, 0.002, 0.1, " s"),
        ("duration", request.seconds, SHORTEST, most, " s"),
        ("noise scale", request.noise_scale, 0.0, 1e6, ""),
        ("amplitude", request.amplitude, 1e-6, 5.0, ""),
        ("altitude", request.altitude, -500.0, 11_000.0, " m"),  # where the simulated air ends
    ):
        if not low <= value <= high:
            of = f" for a {request.manoeuvre}" if what == "duration" else ""
            raise InputError(f"a {what} of {value:g}{unit} was asked for; give one from {low:g} to {high:g}{unit}{of}")


def grid_of(request: Request) -> tuple[Series, slice]:
    """Time of every sample that is flown, s, and those of them that are recorded; the record begins at 0."""
    dt, before = request.dt, 2.0 if request.manoeuvre == RANDOM_STALL else BEFORE
    first, kept, last = round(before / dt), round(request.seconds / dt) + 1, round(AFTER / dt)
    return (np.arange(first + kept + last) - first) * dt, slice(first, first + kept)
