"""The ATTAS stall model flown through recorded inputs, written down for this one model: what a user would write."""

import jax
import jax.numpy as jnp

from bayes_aero.physics.atmosphere import GRAVITY


def bare_jacobian(names, a, outputs, theta, begin, inputs, dt):
    """Outputs (n, c) and their derivatives (n, c, k + 5) by parameters and initial state."""
    tangents = jnp.eye(theta.size + begin.size)

    def respond(both):
        return _simulate(dict(zip(names, both[: theta.size], strict=True)), a, outputs, both[theta.size :], inputs, dt)

    both = jnp.concatenate([theta, begin])
    response, slopes = jax.vmap(lambda t: jax.jvp(respond, (both,), (t,)), out_axes=(None, -1))(tangents)
    return response, slopes


def _simulate(v, a, outputs, begin, inputs, dt):
    def step(x, rows):
        now, then = rows
        middle = {name: 0.5 * (now[name] + then[name]) for name in now}
        k1, seen = _motion(v, a, x, now)
        k2, _ = _motion(v, a, x + 0.5 * dt * k1, middle)
        k3, _ = _motion(v, a, x + 0.5 * dt * k2, middle)
        k4, _ = _motion(v, a, x + dt * k3, then)
        return x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), jnp.stack([seen[name] for name in outputs])

    then = {name: jnp.concatenate([x[1:], x[-1:]]) for name, x in inputs.items()}
    return jax.lax.scan(step, begin, (inputs, then))[1]


def _motion(v, a, x, u):
    V, alpha, theta, q, height = x
    sin, cos = jnp.sin(alpha), jnp.cos(alpha)
    p, r, beta, phi, de = (u[name] for name in ("p", "r", "beta", "phi", "elevator"))
    force, chords = 0.5 * u["density"] * V * V * a.wing_area, a.chord / V
    attached = v["CL0"] + (v["CLa"] + v["CLaM"] * V / u["sound"]) * alpha - v["Cmde"] * a.chord / a.tail_arm * de
    drag = v["CD0"] + attached * attached / (v["e"] * jnp.pi * a.aspect_ratio)
    moment = v["Cm0"] + v["Cma"] * alpha + v["Cmq"] * q * chords + v["Cmde"] * de
    x_arm, y_arm, z_arm = a.accelerometer
    side = u["ay"] - (x_arm * (p * q + u["r_dot"]) - y_arm * (p * p + r * r) + z_arm * (q * r - u["p_dot"]))
    gx, gz = -GRAVITY * jnp.sin(theta), GRAVITY * jnp.cos(theta) * jnp.cos(phi)
    lateral = jnp.tan(beta) * (p * cos + r * sin)

    def flow(rate):
        felt = alpha - v["tau2"] * chords * jnp.minimum(rate, 0.0)
        X = jax.nn.sigmoid(-2.0 * v["a1"] * (felt - v["alpha_star"]))
        CL = attached + v["CLa"] * alpha * (0.25 * (1.0 + jnp.sqrt(jnp.maximum(X, 1e-30))) ** 2 - 1.0)
        CD = drag + v["CDX"] * (1.0 - X)
        fx = (force * (CL * sin - CD * cos) + u["thrust"]) / a.mass
        fz = force * (-CL * cos - CD * sin) / a.mass
        return X, CL, CD, fx, fz

    def excess(rate):
        _, _, _, fx, fz = flow(rate)
        return rate - (q - lateral + ((fz + gz) * cos - (fx + gx) * sin) / (V * jnp.cos(beta)))

    # The derivative of the implicit function, so that none is carried through the iteration.
    rate = jax.lax.custom_root(excess, jnp.zeros(()), lambda f, _: _bracketed(f), lambda g, y: y / g(1.0))
    X, CL, CD, fx, fz = flow(rate)
    ax, ay, az = fx + gx, side + GRAVITY * jnp.cos(theta) * jnp.sin(phi), fz + gz
    V_dot = (ax * cos + az * sin) * jnp.cos(beta) + ay * jnp.sin(beta)
    theta_dot = q * jnp.cos(phi) - r * jnp.sin(phi)
    climb = V * (
        cos * jnp.cos(beta) * jnp.sin(theta)
        - (jnp.sin(beta) * jnp.sin(phi) + sin * jnp.cos(beta) * jnp.cos(phi)) * jnp.cos(theta)
    )
    Cm = moment + v["CmX"] * (1.0 - X)
    CX, CZ = CL * sin - CD * cos, -CL * cos - CD * sin
    Cm = Cm + (CX * a.reference_point[2] - CZ * a.reference_point[0]) / a.chord
    pitching = force * a.chord * Cm + u["thrust"] * a.engine[2]
    q_dot = (pitching + (a.Iz - a.Ix) * p * r + a.Ixz * (r * r - p * p)) / a.Iy
    seen = {"airspeed": V, "alpha": alpha, "theta": theta, "q": q, "altitude": height}
    seen["ax"] = fx - x_arm * (q * q + r * r) + y_arm * (p * q - u["r_dot"]) + z_arm * (p * r + q_dot)
    seen["az"] = fz + x_arm * (p * r - q_dot) + y_arm * (q * r + u["p_dot"]) - z_arm * (p * p + q * q)
    return jnp.stack([V_dot, rate, theta_dot, q_dot, climb]), seen


def _bracketed(excess):
    """Newton's steps, a middle of the bracket where one leaves it, until the step is nothing."""
    first = -excess(jnp.zeros(()))

    def closer(state):
        low, high, rate, _, count = state
        value, slope = jax.jvp(excess, (rate,), (jnp.ones_like(rate),))
        low, high = jnp.where(value < 0.0, rate, low), jnp.where(value > 0.0, rate, high)
        new = rate - value / slope
        new = jnp.where((new < low) | (new > high) | (slope <= 0.0), 0.5 * (low + high), new)
        return low, high, new, new - rate, count + 1

    begin = (jnp.minimum(first, 0.0), jnp.maximum(first, 0.0), 0.5 * first, jnp.inf, 0)
    return jax.lax.while_loop(lambda s: (jnp.abs(s[3]) > 1e-10) & (s[4] < 60), closer, begin)[2]
