"""An HFB 320 in pitch, in gusts of first order: a simulator that shares no code."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import fsolve

from bayes_aero.flight.record import FlightRecord

TRUTH = {
    "CL0": -0.13, "CLV": 0.16, "CLa": 4.5, "CD0": 0.125, "CDV": -0.065, "CDa": 0.315,
    "Cm0": 0.139, "CmV": -0.018, "Cma": -1.0, "Cmq": -26.5, "Cmde": -1.44, "Cma2": 0.0,
}  # fmt: skip
GUST, LENGTH = {"w": 1.5, "u": 1.0}, 200.0  # m/s, m
NOISE = {"airspeed": 0.1, "alpha": 0.001, "theta": 0.0005, "q": 0.0005, "ax": 0.02, "az": 0.05}
MASS, INERTIA, AREA, CHORD, DENSITY, V0 = 7472.0, 91388.0, 30.097, 2.43, 0.792, 104.67
TILT, ARM, G = 0.0524, -0.642, 9.80665
DT, FINER, SECONDS = 0.05, 10, 60.0

Beyond = Callable[[float, float, float, float, float], tuple[float, float, float]]
"""What is added to CL, CD and Cm by airspeed, alpha, q, elevator and thrust, SI."""


def _body(t, V, alpha, q, elevator, thrust, beyond: Beyond):
    """Specific force along body x and z, and pitch acceleration, of a flow; the published equations (TC04)."""
    pressure = 0.5 * DENSITY * V**2 * AREA
    CL = t["CL0"] + t["CLV"] * V / V0 + t["CLa"] * alpha
    CD = t["CD0"] + t["CDV"] * V / V0 + t["CDa"] * alpha
    Cm = t["Cm0"] + t["CmV"] * V / V0 + t["Cma"] * alpha + t["Cmq"] * q * CHORD / (2.0 * V0) + t["Cmde"] * elevator
    Cm += t["Cma2"] * alpha**2
    CL, CD, Cm = (x + more for x, more in zip((CL, CD, Cm), beyond(V, alpha, q, elevator, thrust), strict=True))
    ax = pressure * (CL * np.sin(alpha) - CD * np.cos(alpha)) / MASS + thrust / MASS * np.cos(TILT)
    az = -pressure * (CL * np.cos(alpha) + CD * np.sin(alpha)) / MASS - thrust / MASS * np.sin(TILT)
    return ax, az, (pressure * CHORD * Cm + thrust * ARM * np.cos(TILT)) / INERTIA


def _rates(t, x, gust, elevator, thrust, beyond):
    V, alpha, theta, q = x
    ax, az, q_dot = _body(t, V + gust[1], alpha + gust[0] / V, q, elevator, thrust, beyond)
    along = ax * np.cos(alpha) + az * np.sin(alpha) - G * np.sin(theta - alpha)
    turn = q + (az * np.cos(alpha) - ax * np.sin(alpha) + G * np.cos(theta - alpha)) / V
    return np.array([along, turn, q, q_dot])


def gusty_flight(
    seed: int,
    *,
    gust: Mapping[str, float] = GUST,
    seconds: float = SECONDS,
    truth: Mapping[str, float] | None = None,
    beyond: Beyond = lambda *_: (0.0, 0.0, 0.0),
) -> FlightRecord:
    """Elevator steps and a slow sweep of alpha from trimmed level flight; Heun's method.

    `gust`: standard deviations of the vertical (w) and longitudinal (u) gust, m/s. `truth` replaces derivatives,
    `beyond` adds to the coefficients.
    """
    rng, h, known = np.random.default_rng(seed), DT / FINER, TRUTH | dict(truth or {})
    trim = lambda y: _rates(known, [104.0, y[0], y[0], 0.0], (0.0, 0.0), y[1], 1e3 * y[2], beyond)[[0, 1, 3]]
    alpha, still, thrust = fsolve(trim, [0.11, 0.0, 9.0])
    n, intensity = round(seconds / DT), np.array(list(gust.values()))
    x, met, rows = np.array([104.0, alpha, alpha, 0.0]), np.array([rng.normal(0.0, s) for s in intensity]), []
    t = DT * np.arange(n)
    command = still + np.deg2rad(1.2) * np.sign(np.sin(2.0 * np.pi * t / 7.0)) * (t > 3.0)
    command -= np.deg2rad(1.5) * np.sin(2.0 * np.pi * t / 40.0)
    for k in range(n):
        V, angle, theta, q = x
        flow = (V + met[1], angle + met[0] / V)
        ax, az, _ = _body(known, *flow, q, command[k], 1e3 * thrust, beyond)
        rows.append([*flow, theta, q, ax, az])
        ahead = command[min(k + 1, n - 1)]
        for j in range(FINER):
            elevator = command[k] + (ahead - command[k]) * np.array([j, j + 1]) / FINER
            kept = np.exp(-V / LENGTH * h)
            new = kept * met + np.sqrt(1.0 - kept**2) * rng.normal(size=2) * intensity
            first = _rates(known, x, met, elevator[0], 1e3 * thrust, beyond)
            second = _rates(known, x + h * first, new, elevator[1], 1e3 * thrust, beyond)
            x, met = x + 0.5 * h * (first + second), new
    clean = np.array(rows)
    channels = {name: clean[:, i] + rng.normal(0.0, sd, n) for i, (name, sd) in enumerate(NOISE.items())}
    channels |= {"elevator": command, "thrust": np.full(n, 1e3 * thrust), "density": np.full(n, DENSITY)}
    return FlightRecord("gusty", t, channels, "simulated", "")
