"""What recorders leave of a stranger's flights, with an effect hidden in them, and the card of that aircraft.

As the package's users may have it: knots, degrees, feet, g, nz up, elevator trailing edge up; noise white or coloured,
filtered before it was sampled, rounded to the recorder's last digit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import signal
from stranger import G, Plane, fly, plane

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
time = {{ label = "Time_s", unit = "s" }}
airspeed = {{ label = "KTAS", unit = "kt" }}
alpha = {{ label = "AOA_deg", unit = "deg" }}
theta = {{ label = "THETA_deg", unit = "deg" }}
q = {{ label = "QB_dps", unit = "deg/s" }}
ax = {{ label = "NXB_g", unit = "g0" }}
az = {{ label = "NZB_g", unit = "g0", sign = -1 }}
altitude = {{ label = "HP_ft", unit = "ft" }}
elevator = {{ label = "DE_TEU_deg", unit = "deg", sign = -1 }}
thrust = {{ label = "FN_lbf", unit = "lbf" }}
p = {{ label = "PB_dps", unit = "deg/s" }}
r = {{ label = "RB_dps", unit = "deg/s" }}
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
