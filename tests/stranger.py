"""Another aircraft, flown by a simulator that shares no code with the package: NumPy and textbook equations alone.

Drawn at random: size, mass, derivatives, stall; then stalls with a 3-2-1-1 before and after, engine and elevator with
lags. In gusts of the Dryden kind, along and across the path, air data and forces are those of the air that is met.

Its records, with an effect hidden in them, are as the package's users may have them: knots, degrees, feet, g, nz up,
elevator trailing edge up; noise white or coloured, filtered before it was sampled, rounded to the last digit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path

import numpy as np
from scipy import signal
from scipy.optimize import fsolve

G = 9.80665
Rates = Callable[..., np.ndarray]

USUAL = {
    "CL0": 0.3, "CLa": 5.2, "a1": 22.0, "alpha_star": 0.27, "CD0": 0.032, "e": 0.78, "CDX": 0.06, "Cm0": 0.05,
    "Cma": -0.85, "Cmq": -17.0, "Cmde": -1.35, "CmX": -0.06,
} | dict.fromkeys((
    "thrust_arm", "Cma2", "Cmadot", "CLq", "tau1", "thrust_lift", "CLmin", "CLde_extra", "CDde", "CmdeX", "CmqX",
    "CmaX", "thrust_lag", "vertical_wind",
), 0.0)  # fmt: skip
SIZES = ("mass", "S", "c", "b", "Iy", "tail", "speed", "power")
Constants = make_dataclass("Constants", [*SIZES, *((name, float, x) for name, x in USUAL.items())], frozen=True)


@dataclass(frozen=True)
class Plane(Constants):
    """Constants, SI and radians; `Cmq` belongs to q c/2V."""

    def density(self, h: float) -> float:
        """Standard atmosphere, kg/m^3."""
        return 1.225 * (1.0 - 2.25577e-5 * h) ** 4.25588

    def thrust(self, V: float, lever: float, h: float) -> float:
        """Propeller of constant power, N."""
        return min(lever * self.power / max(V, 0.6 * self.speed), self.power / (0.8 * self.speed)) * (
            self.density(h) / 1.225
        )

    def settled(self, alpha: float) -> float:
        """Separation point in steady flow."""
        return 0.5 * (1.0 - np.tanh(self.a1 * (alpha - self.alpha_star)))

    def forces(self, alpha: float, qhat: float, elevator: float, X: float, CT: float = 0.0) -> tuple[float, float]:
        """CL and CD; the tail's lift makes its moment, drag is that of all the lift."""
        CL = self.CL0 + self.CLa * alpha * ((1.0 + np.sqrt(X)) / 2.0) ** 2 - self.Cmde * self.c / self.tail * elevator
        CL += self.CLq * qhat
        CL += self.CLde_extra * elevator
        attached = self.CL0 + self.CLa * alpha - self.Cmde * self.c / self.tail * elevator
        polar = CL**2 + self.CLmin * (self.CLmin - 2.0 * attached)
        CD = self.CD0 + polar / (np.pi * self.b**2 / self.S * self.e) + self.CDX * (1.0 - X) + self.CDde * elevator
        return CL + self.thrust_lift * CT, CD

    def rates(self, x: np.ndarray, elevator: float, lever: float, ahead: float = 0.0, up: float = 0.0) -> np.ndarray:
        """Derivatives of V, alpha, theta, q, h, X, where a gust meets the aircraft from ahead and from below, m/s."""
        speed, path, theta, q, h, X = x
        V, alpha, climb = speed + ahead, path + up / speed, theta - path
        X = X if self.tau1 else self.settled(alpha)
        pressure, T = 0.5 * self.density(h) * V**2, self.thrust(V, lever, h)
        CL, CD = self.forces(alpha, q * self.c / V, elevator, X, T / (pressure * self.S))
        L, D = pressure * self.S * CL, pressure * self.S * CD
        tilt = alpha - path  # of the air that is met
        along = T * np.cos(path) - D * np.cos(tilt) + L * np.sin(tilt)
        across = T * np.sin(path) + L * np.cos(tilt) + D * np.sin(tilt)
        alpha_dot = q - across / (self.mass * speed) + G * np.cos(climb) / speed
        Cm = self.Cm0 + (self.Cma + self.Cma2 * alpha) * alpha + self.Cmde * elevator + self.CmX * (1.0 - X)
        Cm += (self.Cmq / 2.0 * q + self.Cmadot * alpha_dot) * self.c / V
        Cm += (1.0 - X) * (self.CmdeX * elevator + self.CmqX * q * self.c / V + self.CmaX * alpha)
        X_dot = (self.settled(alpha) - X) * V / (self.tau1 * self.c) if self.tau1 else 0.0
        q_dot = (pressure * self.S * self.c * Cm + T * self.thrust_arm) / self.Iy
        V_dot = along / self.mass - G * np.sin(climb)
        return np.array([V_dot, alpha_dot, q, q_dot, speed * np.sin(climb) + self.vertical_wind, X_dot])


def plane(rng: np.random.Generator) -> Plane:
    """Between a light aircraft and a small commuter."""
    s = rng.uniform(0.8, 1.6)
    mass = 1850.0 * s**3 * rng.uniform(0.8, 1.2)
    found = Plane(
        mass, 17.2 * s**2, 1.58 * s, 11.0 * s, mass * (1.19 * s) ** 2 * rng.uniform(0.9, 1.3),
        4.4 * s * rng.uniform(0.9, 1.1), 60.0 * np.sqrt(s), 296e3 * s**3.5,
    )  # fmt: skip
    spread = ("CL0", "CLa", "a1", "alpha_star", "CD0", "e", "CDX", "Cm0", "Cma", "Cmq", "Cmde", "CmX")
    return replace(found, **{name: getattr(found, name) * rng.uniform(0.87, 1.13) for name in spread})


def fly(
    p: Plane, rng: np.random.Generator, dt: float, seconds: float = 90.0, height: float = 2500.0, gusts: float = 0.0
) -> np.ndarray:
    """Rows t, V, alpha, theta, q, ax, az, h, elevator, thrust of one manoeuvre; `gusts` is their deviation, m/s."""
    V = p.speed * rng.uniform(0.98, 1.08)

    def unbalanced(z):
        return p.rates(np.array([V, z[0], z[0], 0.0, height, p.settled(z[0])]), z[1], z[2])[[0, 1, 3]]

    alpha, trim, lever = fsolve(unbalanced, [0.05, -0.02, 0.4])
    x, level, held = np.array([V, alpha, alpha, 0.0, height, p.settled(alpha)]), alpha, trim
    size, unit = np.radians(rng.uniform(1.8, 2.6)), rng.uniform(0.4, 0.6)
    first = rng.uniform(3.0, 6.0)
    pull, slope = first + rng.uniform(9.0, 12.0), np.radians(rng.uniform(0.4, 0.6))
    recover = pull + rng.uniform(27.0, 33.0)
    second, idle = recover + rng.uniform(12.0, 16.0), rng.uniform(0.4, 0.9)

    edges = unit * np.array([0.0, 3.0, 5.0, 6.0, 7.0])

    def steps(t):
        return size * (0.0, 1.0, -1.0, 1.0, -1.0, 0.0)[int(np.searchsorted(edges, t, "right"))]

    rows, elevator, engine, force = [], trim, lever, None
    air = _gusts(rng, round(seconds / dt) + 2, V * dt, gusts)
    for k in range(round(seconds / dt) + 1):
        t, wanted = k * dt, lever
        if t < pull:
            command = held = trim + steps(t - first) + 0.25 * (x[2] - level) + 0.15 * x[3]
        elif t < recover:
            command, wanted = held - slope * (t - pull), lever * idle
        elif t < recover + 4.0:
            command, wanted = trim + np.radians(3.0), 1.4 * lever
        else:
            command = trim + steps(t - second) + 0.3 * (x[2] - np.radians(1.0)) + 0.15 * x[3]
            if t > second + 6.0:
                wanted = lever * (1.5 if (t - second) % 8.0 < 4.0 else 0.6)
        after = elevator + np.clip(np.clip(command, -0.4, 0.3) - elevator, -0.44 * dt, 0.44 * dt)
        running, row = engine + (wanted - engine) * dt / 0.8, _sensed(p, x, elevator, engine, *air[:, k])
        if p.thrust_lag:  # the engine deck knows the lever only
            deck, full = p.thrust(x[0], wanted, x[4]), p.thrust(x[0], 1e-6, x[4]) / 1e-6
            force = deck if force is None else force + (deck - force) * -np.expm1(-dt / p.thrust_lag)
            running, row = force / full, (*row[:-1], deck)
        rows.append((t, *row))
        x = advanced(p.rates, x, dt, (elevator, after), (engine, running), *air[:, k : k + 2])
        elevator, engine = after, running
    return np.array(rows).T


def _gusts(rng: np.random.Generator, n: int, metres: float, deviation: float) -> np.ndarray:
    """Two first-order Markov processes in space (2, n), a sample every so many metres; none is drawn in calm air."""
    found = np.zeros((2, n))
    if deviation > 0.0:
        share = np.exp(-metres / rng.uniform(150.0, 500.0))
        white = deviation * rng.standard_normal((2, n))
        found[:, 0] = white[:, 0]
        for k in range(1, n):
            found[:, k] = share * found[:, k - 1] + np.sqrt(1.0 - share**2) * white[:, k]
    return found


def _sensed(
    p: Plane, x: np.ndarray, elevator: float, lever: float, ahead: float = 0.0, up: float = 0.0
) -> tuple[float, ...]:
    V, alpha, theta, q, h, X = x
    V, alpha = V + ahead, alpha + up / V
    T, pressure = p.thrust(V, lever, h), 0.5 * p.density(h) * V**2 * p.S
    CL, CD = p.forces(alpha, q * p.c / V, elevator, X if p.tau1 else p.settled(alpha), T / pressure)
    ax = (T + pressure * (CL * np.sin(alpha) - CD * np.cos(alpha))) / p.mass
    az = -pressure * (CL * np.cos(alpha) + CD * np.sin(alpha)) / p.mass
    return V, alpha, theta, q, ax, az, h, elevator, T


def advanced(rates: Rates, x: np.ndarray, dt: float, *inputs, parts: int = 5) -> np.ndarray:
    """Runge-Kutta of fourth order, inputs (elevator, lever, gusts) linear within the sample."""
    h = dt / parts
    for i in range(parts):
        u = [tuple(a + (b - a) * (i + part) / parts for a, b in inputs) for part in (0.0, 0.5, 1.0)]
        k1 = rates(x, *u[0])
        k2 = rates(x + h / 2.0 * k1, *u[1])
        k3 = rates(x + h / 2.0 * k2, *u[1])
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(x + h * k3, *u[2]))
    return x


# What recorders leave of these flights, and the card of the aircraft
NOISE = (0.0, 0.15, 9e-4, 9e-4, 1e-3, 0.02, 0.04, 0.6, 3.5e-4, 5.0)  # of t, V, alpha, theta, q, ax, az, h, elevator, T
HEADINGS = "Time_s,KTAS,AOA_deg,THETA_deg,QB_dps,NXB_g,NZB_g,HP_ft,DE_TEU_deg,FN_lbf,PB_dps,RB_dps"
DIGITS = np.array([0.0, 0.2, 0.1, 0.1, 0.1, 0.004, 0.004, 5.0, 0.1, 5.0, 0.1, 0.1])  # coarse ones, as HEADINGS has them
HIDDEN = {  # parameter, sizes within which it is drawn, SI, all of them clearly visible; whether of either sign
    "thrust_moment": ("thrust_arm", 0.12, 0.3, True), "alpha_squared_moment": ("Cma2", 1.0, 3.0, True),
    "alpha_dot_moment": ("Cmadot", -9.0, -4.0, False), "pitch_rate_lift": ("CLq", 3.0, 8.0, False),
    "separation_lag": ("tau1", 8.0, 20.0, False), "alpha_bias": ("alpha_bias", 0.006, 0.02, True),
    "alpha_scale": ("alpha_scale", 0.04, 0.09, True), "airspeed_scale": ("airspeed_scale", 0.02, 0.05, True),
    "pitch_rate_bias": ("pitch_rate_bias", 0.003, 0.008, True), "accel_x_bias": ("accel_x_bias", 0.06, 0.2, True),
    "elevator_delay": ("elevator_delay", 0.03, 0.1, False), "thrust_lift": ("thrust_lift", 0.2, 0.6, True),
    "drag_offset": ("CLmin", 0.08, 0.3, True), "elevator_lift": ("CLde_extra", 0.2, 0.6, True),
    "elevator_drag": ("CDde", 0.04, 0.12, True), "separated_elevator": ("CmdeX", 0.4, 1.0, False),
    "separated_damping": ("CmqX", 8.0, 20.0, True), "separated_alpha_moment": ("CmaX", 0.4, 0.8, True),
    "thrust_scale": ("thrust_scale", 0.06, 0.2, True), "thrust_lag": ("thrust_lag", 0.7, 2.5, False),
    "mass_scale": ("mass_scale", 0.03, 0.1, True), "alpha_delay": ("alpha_delay", 0.05, 0.2, False),
    "pitch_rate_scale": ("pitch_rate_scale", 0.03, 0.1, True), "airspeed_bias": ("airspeed_bias", 1.0, 4.0, True),
    "accel_z_bias": ("accel_z_bias", 0.15, 0.5, True), "altitude_scale": ("altitude_scale", 0.01, 0.05, True),
    "pitch_attitude_bias": ("pitch_attitude_bias", 0.006, 0.02, True),
    "vertical_wind": ("vertical_wind", 0.6, 2.5, True),
}  # fmt: skip


@dataclass(frozen=True)
class Recorder:
    """`rho` of the noise from sample to sample; corner of a second-order low pass, Hz; last digits as in DIGITS."""

    rho: float = 0.0
    corner: float | None = None
    digits: float = 0.0

    @classmethod
    def poor(cls, rng: np.random.Generator) -> Recorder:
        """One that colours, filters and rounds."""
        return cls(rng.uniform(0.5, 0.95), rng.uniform(3.0, 7.0), rng.uniform(0.3, 1.0))

    def noise(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Of unit deviation."""
        white = rng.standard_normal(shape)
        return np.sqrt(1.0 - self.rho**2) * signal.lfilter([1.0], [1.0, -self.rho], white) if self.rho else white

    def filtered(self, rows: np.ndarray, dt: float) -> np.ndarray:
        """All channels by the same filter, in equilibrium at first."""
        if self.corner is None:
            return rows
        sections = signal.butter(2, self.corner, fs=1.0 / dt, output="sos")
        rest = signal.sosfilt_zi(sections)
        return np.array([signal.sosfilt(sections, row, zi=rest * row[0])[0] for row in rows])

    def rounded(self, columns: np.ndarray) -> np.ndarray:
        """To the last digit, but for the time."""
        quanta = (self.digits * DIGITS[1:])[:, None]
        if self.digits:
            columns[1:] = np.round(columns[1:] / quanta) * quanta
        return columns


def misread(rows: np.ndarray, errors: Mapping[str, float]) -> np.ndarray:
    """The flight as sensors with these errors see it."""

    def error(name: str) -> float:
        return errors.get(name, 0.0)

    t, V, alpha, theta, q, ax, az, h, elevator, T = rows
    alpha = np.interp(t - error("alpha_delay"), t, alpha)
    return np.array(
        (
            t, V * (1.0 + error("airspeed_scale")) + error("airspeed_bias"),
            alpha * (1.0 + error("alpha_scale")) + error("alpha_bias"), theta + error("pitch_attitude_bias"),
            q * (1.0 + error("pitch_rate_scale")) + error("pitch_rate_bias"), ax + error("accel_x_bias"),
            az + error("accel_z_bias"), h * (1.0 + error("altitude_scale")),
            np.interp(t - error("elevator_delay"), t, elevator), T / (1.0 + error("thrust_scale")),
        )
    )  # fmt: skip


def write(
    path: Path, rows: np.ndarray, errors: Mapping[str, float], rng: np.random.Generator, recorder: Recorder = Recorder()
) -> None:
    """What a recorder and sensors with these errors leave of the flight."""
    noisy = misread(rows, errors) + np.array(NOISE)[:, None] * recorder.noise(rng, rows.shape)
    noisy[1:] = recorder.filtered(noisy[1:], rows[0, 1] - rows[0, 0])
    t, V, alpha, theta, q, ax, az, h, elevator, T = noisy
    lateral = 9e-4 * rng.standard_normal((2, len(t)))
    deg = np.degrees
    columns = np.array(
        (t, V / 0.514444, deg(alpha), deg(theta), deg(q), ax / G, -az / G, h / 0.3048, -deg(elevator), T / 4.4482216,
         *deg(lateral))
    )  # fmt: skip
    np.savetxt(path, recorder.rounded(columns).T, delimiter=",", header=HEADINGS, comments="", fmt="%.5f")


def flown(
    folder: Path,
    rng: np.random.Generator,
    name: str | None,
    gusts: float = 0.0,
    recorder: Recorder = Recorder(),
    manoeuvres: int = 2,
) -> tuple[Plane, float, list[Path]]:
    """Records and `card.toml` of a random aircraft that stays in its envelope, an effect hidden in them; its size.

    Thrust arms are in proportion to the chord.
    """
    for _ in range(20):
        p, errors, size = plane(rng), {}, 0.0
        if name is not None:
            parameter, least, most, either = HIDDEN[name]
            size = float(rng.uniform(least, most) * (rng.choice([-1.0, 1.0]) if either else 1.0))
            size *= p.c / 1.58 if parameter == "thrust_arm" else 1.0
            if hasattr(p, parameter):
                p = replace(p, **{parameter: size})
            else:
                errors = {parameter: size}
        dt = float(rng.choice([0.02, 0.04, 0.05]))
        with np.errstate(invalid="ignore", over="ignore"):
            flights = [fly(p, rng, dt, gusts=gusts) for _ in range(manoeuvres)]
        if all(np.all(np.isfinite(x)) and x[2].max() < 0.5 and np.abs(x[3]).max() < 0.9 for x in flights):
            break
    else:
        raise RuntimeError("no such aircraft could be flown")
    files = [folder / f"run{number}.csv" for number in range(1, manoeuvres + 1)]
    for path, rows in zip(files, flights, strict=True):
        write(path, rows, errors, rng, recorder)
    told = replace(p, mass=p.mass / (1.0 + errors.get("mass_scale", 0.0)))
    (folder / "card.toml").write_text(card_text(told))
    return p, size, files


def card_text(p: Plane) -> str:
    """The right card of the aircraft, but for what is hidden."""
    names = ["time", "airspeed", "alpha", "theta", "q", "ax", "az", "altitude", "elevator", "thrust", "p", "r"]
    units = ["s", "kt", "deg", "deg", "deg/s", "g0", "g0", "ft", "deg", "lbf", "deg/s", "deg/s"]
    channels = "\n".join(
        f'{name} = {{ label = "{heading}", unit = "{unit}"{", sign = -1" if name in ("az", "elevator") else ""} }}'
        for name, heading, unit in zip(names, HEADINGS.split(","), units, strict=True)
    )
    return f"""
title = "another aircraft"
source = "a simulator of its own"
[aircraft]
mass = "{p.mass} kg"
Ix = "{p.Iy} kg m^2"
Iy = "{p.Iy} kg m^2"
Iz = "{2.0 * p.Iy} kg m^2"
Ixz = "0 kg m^2"
wing_area = "{p.S} m^2"
chord = "{p.c} m"
half_span = "{p.b / 2.0} m"
aspect_ratio = {p.b**2 / p.S}
tail_arm = "{p.tail} m"
[channels]
{channels}
[constants]
ay = "0 g0"
phi = "0 deg"
beta = "0 deg"
[derived]
density = "standard atmosphere"
mach = "standard atmosphere"
[model]
effects = [
  "attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
  "flow_separation", "kirchhoff_lift", "separated_drag", "separated_moment", "separated_induced_drag",
]
fixed = {{ induced_share = 1.0 }}
"""
