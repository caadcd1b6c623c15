"""Another aircraft in six degrees of freedom, by a simulator that shares no code with the package: NumPy and textbook
equations alone, in body velocities u, v, w and Euler angles.

Each half of the wing has its own angle of attack, of rolling and dihedral too, and its own separation point: lift,
drag, roll and yaw come from one mechanism, and one half may stall first. What is not the wing's is linear or, in
sideslip, cubic. Source of the equations: Stevens, Lewis, Johnson, *Aircraft Control and Simulation*, 3rd ed. 2016,
table 1.7-1.
"""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass, replace

import numpy as np
from scipy.optimize import fsolve
from stranger import G, advanced

KINDS = ("elevator", "aileron", "rudder", "stall", "stall_in_bank")
BANK, SWAY = 0.25, 5.0  # rad, s
STATES = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "h", "X_left", "X_right")
CONTROLS = ("elevator", "aileron", "rudder", "thrust_left", "thrust_right")

USUAL = {  # SI and radians; rates made free of units by c/V and b/2V
    "mass": 17600.0, "Ix": 140e3, "Iy": 330e3, "Iz": 430e3, "Ixz": 20e3, "Ixy": 0.0, "Iyz": 0.0,
    "S": 64.0, "c": 3.16, "b": 21.5, "engine_arm": 2.8, "engine_drop": 0.6,
    "nose": (1.5, 0.0, -0.4),  # accelerometers, from the centre of gravity
    "station": 5.0,  # m, where half a wing acts
    "dihedral": 0.1, "CL0": 0.15, "CLa": 5.0,
    "CLde_extra": 0.1,  # beyond that of the tail's moment
    "CD0": 0.035, "e": 0.8, "tail": 10.0, "CDX": 0.06, "Cm0": 0.06, "Cma": -0.9, "Cmq": -14.0, "Cmde": -1.3,
    "CmX": -0.05, "a1": 22.0, "alpha_star": 0.27,
    "first": 0.0,  # rad by which the left half stalls before the right one
    "tau1": 0.0,  # chords
    "CYbe": -0.75, "CYr": 0.3, "CYdr": 0.2, "Clbe": -0.06, "Clp": -0.25, "Clr": 0.16, "Clda": -0.14, "Cldr": 0.02,
    "Cnbe": 0.13, "Cnbbb": 0.0, "Cnp": -0.05, "Cnr": -0.19, "Cnda": 0.01, "Cndr": -0.10, "stalls": True,
    "gust": (0.0, 0.0, 0.0),  # motion of the air along the body axes, m/s
    "aside": 0.0,  # m by which the centre of gravity lies right of the plane of symmetry
    "uneven": 0.0,  # share by which the left engine delivers more than its lever says, and the right one less
}  # fmt: skip
Constants = make_dataclass("Constants", [(name, type(x), x) for name, x in USUAL.items()], frozen=True)


@dataclass(frozen=True)
class Plane(Constants):
    """One of the `USUAL` constants, or others."""

    def density(self, h: float) -> float:
        """Standard atmosphere, kg/m^3."""
        return 1.225 * (1.0 - 2.2557695644629534e-5 * h) ** 4.255879812716677

    def air_data(self, x: np.ndarray) -> tuple[float, float, float]:
        """Airspeed, angle of attack, sideslip."""
        u, v, w = x[:3] - np.array(self.gust)
        V = np.sqrt(u * u + v * v + w * w)
        return V, np.arctan2(w, u), np.arcsin(v / V)

    def halves(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles of attack and steady separation points of the left and the right half."""
        V, alpha, beta = self.air_data(x)
        side = np.array([-1.0, 1.0])
        local = alpha + side * (x[3] * self.station / V + self.dihedral * beta * (self.station > 0.0))
        star = self.alpha_star + np.array([-self.first, 0.0])
        return local, 0.5 * (1.0 - np.tanh(self.a1 * (local - star))) if self.stalls else np.ones(2)

    def coefficients(self, x: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """CL, CD, CY, Cl, Cm, Cn."""
        V, alpha, beta = self.air_data(x)
        p, q, r = x[3:6]
        elevator, aileron, rudder = controls[:3]
        local, steady = self.halves(x)
        X = x[10:12] if self.tau1 else steady
        tail = (self.CLde_extra - self.Cmde * self.c / self.tail) * elevator
        CL, CD, roll, yaw = self.wing(np.array([alpha, *local]), X, tail)
        ph, qh, rh = p * self.b / (2.0 * V), q * self.c / V, r * self.b / (2.0 * V)
        Cm = self.Cm0 + self.Cma * alpha + self.Cmq * qh + self.Cmde * elevator + self.CmX * (1.0 - X.mean())
        CY = self.CYbe * beta + self.CYr * rh + self.CYdr * rudder
        Cl = self.Clbe * beta + self.Clp * ph + self.Clr * rh + self.Clda * aileron + self.Cldr * rudder
        Cn = self.Cnbe * beta + self.Cnbbb * beta**3 + self.Cnp * ph + self.Cnr * rh
        Cn += self.Cnda * aileron + self.Cndr * rudder
        return np.array([CL, CD, CY, Cl + roll, Cm, Cn + yaw])

    def loads(self, x: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force (N) and moment (N m) of air and engines, body axes."""
        V, alpha, _ = self.air_data(x)
        left, right = controls[3:]
        CL, CD, CY, Cl, Cm, Cn = self.coefficients(x, controls)
        pressure = 0.5 * self.density(x[9]) * V**2 * self.S
        left, right = left * (1.0 + self.uneven), right * (1.0 - self.uneven)
        thrust = left + right
        force = pressure * np.array(
            [CL * np.sin(alpha) - CD * np.cos(alpha), CY, -CL * np.cos(alpha) - CD * np.sin(alpha)]
        )
        force[0] += thrust
        moment = pressure * np.array([self.b * Cl, self.c * Cm, self.b * Cn])
        moment += np.array([0.0, thrust * self.engine_drop, (left - right) * self.engine_arm])
        return force, moment + np.cross([0.0, -self.aside, 0.0], force)

    def wing(self, angles: np.ndarray, X: np.ndarray, tail: float) -> np.ndarray:
        """CL, CD, Cl and Cn of both halves and of the `tail`'s lift; `angles` of attack of the whole and of each."""
        lift = 0.5 * (self.CL0 + self.CLa * angles[1:] * _kept(X) + tail)
        drag = 0.5 * (self.CD0 + (2.0 * lift) ** 2 / (np.pi * self.b**2 / self.S * self.e) + self.CDX * (1.0 - X))
        forward, down = lift * np.sin(angles[0]) - drag * np.cos(angles[0]), -lift * np.cos(angles[0])
        y = np.array([-1.0, 1.0]) * self.station / self.b
        return np.array([lift.sum(), drag.sum(), y @ (down - drag * np.sin(angles[0])), -y @ forward])

    def tensor(self) -> np.ndarray:
        """Of inertia."""
        return np.array(
            [[self.Ix, -self.Ixy, -self.Ixz], [-self.Ixy, self.Iy, -self.Iyz], [-self.Ixz, -self.Iyz, self.Iz]]
        )

    def rates(self, x: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """Derivatives of `STATES`."""
        velocity, spin, (phi, theta) = x[:3], x[3:6], x[6:8]
        force, moment = self.loads(x, controls)
        gravity = G * np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
        faster = force / self.mass + gravity - np.cross(spin, velocity)
        tensor = self.tensor()
        turning = np.linalg.solve(tensor, moment - np.cross(spin, tensor @ spin))
        p, q, r = spin
        psi_dot = (q * np.sin(phi) + r * np.cos(phi)) / np.cos(theta)
        angles = [p + psi_dot * np.sin(theta), q * np.cos(phi) - r * np.sin(phi), psi_dot]
        climb = -velocity @ gravity / G
        V = self.air_data(x)[0]
        X_dot = (self.halves(x)[1] - x[10:12]) * V / (self.tau1 * self.c) if self.tau1 else np.zeros(2)
        return np.concatenate([faster, turning, angles, [climb], X_dot])

    def sensed(self, x: np.ndarray, controls: np.ndarray) -> dict[str, float]:
        """What a recorder shows, SI."""
        V, alpha, beta = self.air_data(x)
        rate, force = self.rates(x, controls), self.loads(x, controls)[0] / self.mass
        spin, arm = x[3:6], np.array(self.nose) - np.array([0.0, self.aside, 0.0])
        felt = force + np.cross(rate[3:6], arm) + np.cross(spin, np.cross(spin, arm))
        shown = {"airspeed": V, "alpha": alpha, "beta": beta, "altitude": x[9], "density": self.density(x[9])}
        shown |= dict(zip(("p", "q", "r", "phi", "theta", "psi"), x[3:9], strict=True))
        shown |= dict(zip(("ax", "ay", "az"), felt, strict=True)) | dict(zip(CONTROLS, controls, strict=True))
        return shown | {"thrust": controls[3] + controls[4]}


@dataclass(frozen=True)
class Strips(Plane):
    """One whose halves lose lift and gain drag apart, in body axes at 4/(3 pi) of the half span, and differ in nothing
    else: what they carry attached is in the derivatives. Induced drag is that of attached flow."""

    def wing(self, angles: np.ndarray, X: np.ndarray, tail: float) -> np.ndarray:
        alpha = angles[0]
        lift, drag = 0.5 * self.CLa * alpha * _kept(X), 0.5 * self.CDX * (1.0 - X)
        attached = self.CL0 + self.CLa * alpha + tail
        CD = self.CD0 + attached**2 / (np.pi * self.b**2 / self.S * self.e) + drag.sum()
        forward, down = lift * np.sin(alpha) - drag * np.cos(alpha), -lift * np.cos(alpha) - drag * np.sin(alpha)
        y = np.array([-1.0, 1.0]) * 2.0 / (3.0 * np.pi)  # spans
        return np.array([self.CL0 + tail + lift.sum(), CD, y @ down, -y @ forward])


FIGHTER = {
    "mass": 9300.0, "Ix": 12.9e3, "Iy": 75.7e3, "Iz": 85.6e3, "Ixz": 1.3e3, "S": 27.9, "c": 3.45, "b": 9.14,
    "engine_arm": 0.0, "engine_drop": 0.0, "tail": 5.0, "station": 0.0, "stalls": False,
}  # fmt: skip
Small = make_dataclass("Small", [(name, type(x), x) for name, x in FIGHTER.items()], bases=(Plane,), frozen=True)


@dataclass(frozen=True)
class Fighter(Small):
    """A small fighter whose coefficients are polynomials of the angle of attack, sideslip, rates and controls; nothing
    separates. Form and size are those of a published global model, numbers rounded, the centre of gravity 5 % of the
    chord ahead of the reference. Source: E. A. Morelli, "Global nonlinear parametric modeling with application to F-16
    aerodynamics", American Control Conference, 1998."""

    def coefficients(self, x: np.ndarray, controls: np.ndarray) -> np.ndarray:
        V, a, beta = self.air_data(x)
        de, da, dr = controls[:3]
        ph, qh, rh = x[3] * self.b / (2.0 * V), x[4] * self.c / (2.0 * V), x[5] * self.b / (2.0 * V)

        def of(*factors: float) -> float:
            return float(np.polyval(factors[::-1], a))

        CX = of(-0.02, 0.21, 0.70, -0.90) - (0.29 * de**2 + 0.21 * a * de)
        CX += of(0.5, 8.6, 11.0, -74.0, 61.0) * qh
        CZ = of(-0.14, -4.2, 4.8, -10.0, 8.4) * (1.0 - beta**2) - 0.44 * de
        CZ += of(-30.0, -4.0, 50.0) * qh
        CY = -1.15 * beta + 0.06 * da + 0.16 * dr + of(-0.1, 0.5) * ph + of(0.9, 0.5, -4.0) * rh
        Cl = of(-0.106, -0.58, 0.0, 3.5, -2.8) * beta + of(-0.41, 0.2, 1.3) * ph
        Cl += of(0.06, 0.5, 0.6) * rh + of(-0.13, 0.02, 0.3) * da + of(0.02, 0.03, -0.1) * dr
        Cm = of(-0.02, 0.05, 0.0) + of(-0.6, -0.08, 0.5) * de
        Cm += 0.08 * de**2 + of(-5.2, -3.6, -10.0) * qh + 0.05 * CZ
        Cn = of(0.30, 0.07, -2.1, 0.85) * beta + of(-0.03, -0.4, 0.6) * ph
        Cn += of(-0.37, -0.2, 0.5) * rh + of(-0.03, 0.1) * da + of(-0.09, 0.05, 0.2) * dr
        lift, drag = CX * np.sin(a) - CZ * np.cos(a), -CX * np.cos(a) - CZ * np.sin(a)
        return np.array([lift, drag, CY, Cl, Cm, Cn])


def _kept(X: np.ndarray) -> np.ndarray:
    """Share of the attached lift."""
    return ((1.0 + np.sqrt(np.maximum(X, 0.0))) / 2.0) ** 2


def drawn(rng: np.random.Generator, **changes: float) -> Plane:
    """One whose derivatives differ by up to a tenth from the usual."""
    names = [n for n in Plane.__dataclass_fields__ if n[:2] in ("CL", "CD", "Cm", "CY", "Cl", "Cn")]
    usual = Plane()
    return replace(usual, **{n: getattr(usual, n) * rng.uniform(0.9, 1.1) for n in names} | changes)


def level(plane: Plane, V: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """State and controls of straight level flight without sideslip."""

    def whole(z):
        alpha, phi, elevator, aileron, rudder, thrust = z
        x = np.zeros(12)
        x[[0, 2]], x[[6, 7, 9]] = V * np.array([np.cos(alpha), np.sin(alpha)]), [phi, alpha, h]
        controls = np.array([elevator, aileron, rudder, 0.5e4 * thrust, 0.5e4 * thrust])
        x[10:12] = plane.halves(x)[1]
        return x, controls

    found = fsolve(lambda z: plane.rates(*whole(z))[:6], [0.05, 0.0, -0.02, 0.0, 0.0, 2.0], xtol=1e-13)
    return whole(found)


def fly(
    plane: Plane,
    kind: str,
    rng: np.random.Generator,
    *,
    dt: float = 0.04,
    seconds: float = 25.0,
    V: float = 120.0,
    gust: float = 0.0,
) -> dict[str, np.ndarray]:
    """Channels by name, and `time`, of a manoeuvre of `KINDS` from level flight.

    `gust`: standard deviation of the gusts along each body axis, m/s; of first order, 300 m long.
    """
    x, trim = level(plane, V * rng.uniform(0.97, 1.03), 4000.0)
    size, unit, n = np.radians(rng.uniform(1.5, 2.0)), rng.uniform(0.5, 0.7), round(seconds / dt) + 1
    edges, step = 2.0 + unit * np.array([0.0, 3.0, 5.0, 6.0, 7.0]), (0.0, 1.0, -1.0, 1.0, -1.0, 0.0)

    def command(t: float, x: np.ndarray) -> np.ndarray:
        multi = step[int(np.searchsorted(edges, t, "right"))]
        away = np.zeros(5)
        away[0] = 0.3 * (x[7] - theta) + 0.2 * x[4] if t > edges[-1] + 4.0 or kind != "elevator" else 0.0
        if kind == "elevator":
            away[0] += size * multi
        elif kind == "aileron":
            away[1] = 3.0 * size * multi
        elif kind == "rudder":
            away[2] = 2.0 * size * multi
        else:
            away[0] = -np.radians(0.35) * min(max(t - 3.0, 0.0), 0.6 * seconds) + 0.1 * x[4]
            away[1] = size * multi
        if kind == "stall_in_bank":  # to and fro
            away[1] = -0.3 * BANK * (1.0 if int(t / SWAY) % 2 else -1.0) * (t > 4.0)
        if kind != "aileron" or t > edges[-1]:
            away[1] += 0.3 * x[6] + 0.3 * x[3]
        return trim + away

    rows, now, theta = [], trim, x[7]
    met = gust * rng.standard_normal(3) if gust else np.zeros(3)
    for k in range(n):
        if gust:
            plane = replace(plane, gust=tuple(met))
        rows.append({"time": k * dt, **plane.sensed(x, now)})
        wanted = command((k + 1) * dt, x)
        after = np.concatenate([now[:3] + np.clip(wanted[:3] - now[:3], -0.5 * dt, 0.5 * dt), wanted[3:]])
        if gust:  # four times within a sample
            for part in range(4):
                kept = np.exp(-V / 300.0 * dt / 4.0)
                met = kept * met + np.sqrt(1.0 - kept**2) * gust * rng.standard_normal(3)
                ends = [now + (after - now) * (part + j) / 4.0 for j in (0, 1)]
                x = advanced(replace(plane, gust=tuple(met)).rates, x, dt / 4.0, ends, parts=1)
        else:
            x = advanced(plane.rates, x, dt, (now, after), parts=2)
        now = after
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
