"""Cards of linear systems, and their response by the matrix exponential: no integration."""

import tomllib

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from bayes_aero.dynamics.pilot import pulses, three_two_one_one
from bayes_aero.flight.card import Card, parse_card, shipped_cards
from bayes_aero.flight.record import FlightRecord

SHORT_PERIOD = """
[channels]
time = { label = "t", unit = "s" }
alpha = { label = "alpha", unit = "deg" }
q = { label = "q", unit = "deg/s" }
elevator = { label = "de", unit = "deg" }
az = { label = "az", unit = "m/s^2", required = false }

[linear]
states = ["alpha", "q"]
[linear.rates.alpha]
Z0 = "1"
Zalpha = "alpha"
Zq = "q"
Zde = "elevator"
[linear.rates.q]
M0 = "1"
Malpha = "alpha"
Mq = "q"
Mde = "elevator"
[linear.outputs.az]
az0 = "1"
Zalpha = { alpha = 90.0 }
Zde = { elevator = 90.0 }
[linear.fixed]
Zq = 1.0
"""
SHORT_PERIOD_TRUTH = {
    "Z0": 0.02, "Zalpha": -0.9, "Zde": -0.06, "M0": 0.08, "Malpha": -2.1, "Mq": -1.3, "Mde": -3.0, "az0": -9.7,
}  # fmt: skip

LATERAL = shipped_cards()["lateral"].read_text()
LATERAL_TRUTH = {
    "L0": 0.01, "Lp": -2.2, "Lr": 0.7, "Lbeta": -4.5, "Lda": -5.0, "Ldr": 1.1,
    "N0": -0.005, "Np": -0.08, "Nr": -0.4, "Nbeta": 2.0, "Nda": 0.3, "Ndr": -1.4,
}  # fmt: skip

FIRST_ORDER = """
[channels]
time = { label = "t", unit = "s" }
alpha = { label = "alpha", unit = "rad" }
elevator = { label = "de", unit = "rad" }

[linear]
states = ["alpha"]
[linear.rates.alpha]
Zalpha = "alpha"
Zde = "elevator"
[linear.fixed]
Zde = -1.0

[parameters]
Zalpha = { prior = { family = "normal", location = -1.0, scale = 1.0 } }
"""


def card_of(text: str) -> Card:
    """The card that a text states."""
    return parse_card(tomllib.loads(text), "linear", "linear.toml")


def first_order_hold(A, B, x0, u, dt):
    """States (n, s) of x' = A x + B u with u (n, m) linear between samples: exact, by one matrix exponential."""
    s, m = B.shape
    big = np.zeros((s + 2 * m, s + 2 * m))
    big[:s, :s], big[:s, s : s + m], big[s : s + m, s + m :] = A * dt, B * dt, np.eye(m)
    step = expm(big)[:s]
    x = [np.asarray(x0, float)]
    for now, change in zip(u[:-1], np.diff(u, axis=0), strict=True):
        x.append(step @ np.concatenate([x[-1], now, change]))
    return np.array(x)


def multistep(n, dt, begin, unit, size):
    """A 3-2-1-1 with edges a sample long, `unit` s a step."""
    return pulses(np.arange(n) * dt, three_two_one_one(begin, unit, size))


def short_period_matrices(truth):
    """A and B of alpha and q, driven by elevator and one."""
    return (
        np.array([[truth["Zalpha"], 1.0], [truth["Malpha"], truth["Mq"]]]),
        np.array([[truth["Zde"], truth["Z0"]], [truth["Mde"], truth["M0"]]]),
    )


def short_period_flight(truth, n=500, dt=0.04, x0=(0.04, 0.01)):
    """True channels of a flight from `x0`: two multisteps of the elevator."""
    u = multistep(n, dt, 1.0, 0.5, 0.03) + multistep(n, dt, 9.0, 0.8, -0.04)
    A, B = short_period_matrices(truth)
    x = first_order_hold(A, B, x0, np.stack([u, np.ones(n)], axis=1), dt)
    az = truth["az0"] + 90.0 * (truth["Zalpha"] * x[:, 0] + truth["Zde"] * u)
    return {"alpha": x[:, 0], "q": x[:, 1], "elevator": u, "az": az}


def disturbed_first_order(n, dt, Zalpha, F, sigma, seed=5):
    """Channels of `FIRST_ORDER` from rest, under white process noise `F` and measurement noise `sigma`; exact steps."""
    rng = np.random.default_rng(seed)
    de = 0.1 * np.sign(np.sin(2.0 * np.pi * dt * np.arange(n) / 3.0))
    phi, x, alpha = np.exp(Zalpha * dt), 0.0, []
    for u in de:
        alpha.append(x)
        x = phi * x - (phi - 1.0) / Zalpha * u + np.sqrt(dt) * F * rng.standard_normal()
    return {"alpha": np.array(alpha) + sigma * rng.standard_normal(n), "elevator": de}


def lateral_flight(truth, n=500, dt=0.04, x0=(0.02, -0.01)):
    """True channels under ailerons, rudder and a prescribed sideslip."""
    t = np.arange(n) * dt
    da, dr = multistep(n, dt, 1.0, 0.4, 0.05), multistep(n, dt, 8.0, 0.6, 0.04)
    beta = CubicSpline(np.linspace(0.0, t[-1], 25), 0.03 * np.sin(1.7 * np.arange(25)))(t)
    A = np.array([[truth[axis + name] for name in ("p", "r")] for axis in "LN"])
    B = np.array([[truth[axis + name] for name in ("beta", "da", "dr", "0")] for axis in "LN"])
    p, r = first_order_hold(A, B, x0, np.stack([beta, da, dr, np.ones(n)], axis=1), dt).T
    left, right = 1.3 * da, -0.7 * da  # half their difference is what rolls
    return {"p": p, "r": r, "beta": beta, "aileron_left": left, "aileron_right": right, "rudder": dr}


def record_of(channels, dt=0.04, noise=None, rng=None, name="linear"):
    """A record with white noise of deviations `noise` by channel."""
    n = len(next(iter(channels.values())))
    sensed = {k: x + (noise or {}).get(k, 0.0) * (rng.standard_normal(n) if rng else 0.0) for k, x in channels.items()}
    return FlightRecord.from_arrays(name, np.arange(n) * dt, sensed)
