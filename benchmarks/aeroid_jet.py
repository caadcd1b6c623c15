"""The small jet of `output_error_speed.py` as a user of aeroid 0.5 writes it, for the benchmarks that race it."""

from contextlib import contextmanager

import numpy as np


def jet_model(xp, aircraft, gravity, states, parameters, rates=()):
    """aeroid's model; `xp` is NumPy for its differences, jax.numpy for its exact gradient. SI.

    `rates`, () or ("q_dot",), are measured after the states.
    """
    import aeroid

    a, half = aircraft, 0.5 * 0.792 * aircraft.wing_area

    def forces(x, u, v):
        V, alpha, q = x[0], x[1], x[3]
        sin, cos, ratio = xp.sin(alpha), xp.cos(alpha), V / a.reference_speed
        CL = v["CL0"] + v["CLV"] * ratio + v["CLa"] * alpha
        CD = v["CD0"] + v["CDV"] * ratio + v["CDa"] * alpha
        Cm = v["Cm0"] + v["CmV"] * ratio + v["Cma"] * alpha
        Cm = Cm + v["Cmq"] * q * (a.rate_length / a.reference_speed) + v["Cmde"] * u[0]
        force, tilt = half * V * V, a.engine_inclination
        ax = (force * (CL * sin - CD * cos) + u[1] * np.cos(tilt)) / a.mass
        az = (force * (-CL * cos - CD * sin) - u[1] * np.sin(tilt)) / a.mass
        return ax, az, (force * a.chord * Cm + u[1] * (np.cos(tilt) * a.engine[2])) / a.Iy

    def dynamics(t, x, u, v):  # noqa: ARG001
        V, alpha, pitch, q = x[0], x[1], x[2], x[3]
        ax, az, q_dot = forces(x, u, v)
        gx, gz = ax - gravity * xp.sin(pitch), az + gravity * xp.cos(pitch)
        V_dot = gx * xp.cos(alpha) + gz * xp.sin(alpha)
        alpha_dot = q + (gz * xp.cos(alpha) - gx * xp.sin(alpha)) / xp.maximum(V, 1.0)  # it is tried at V = 0
        return xp.array([V_dot, alpha_dot, q, q_dot])

    def measured(t, x, u, v):  # noqa: ARG001
        ax, az, q_dot = forces(x, u, v)
        return xp.array([x[0], x[1], x[2], x[3], *[q_dot for _ in rates], ax, az])

    names = [f"x_{name}" for name in states]
    return aeroid.Model(names, ["elevator", "thrust"], parameters, dynamics, (*states, *rates, "ax", "az"), measured)


class KeptRollout:
    """aeroid's compiled simulation of one problem, kept; aeroid itself compiles anew in every call."""

    def __init__(self):
        self.made = None

    @contextmanager
    def __call__(self):
        """While it lasts, aeroid gets what it made before."""
        from aeroid import autodiff

        plain = autodiff._JaxRollout

        def kept(*positional, **named):
            self.made = self.made or plain(*positional, **named)
            return self.made

        autodiff._JaxRollout = kept
        try:
            yield
        finally:
            autodiff._JaxRollout = plain
