"""From recorded accelerations and rates to the coefficients of forces and moments, and back to the motion.

Signals are conditioned as the published ATTAS coefficients were formed (`condition_joined`), all alike (`alike_joined`)
or not at all, where the difference of measured and modelled coefficients is smoothed later (`unsmoothed_joined`).
Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 12 and its companion data set.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from bayes_aero.arrays import AnyArray, Samples, namespace, xp
from bayes_aero.physics.aircraft import NAMES, Aircraft, Axis
from bayes_aero.physics.filters import LONG_REACH, differentiate_joined, inside_joined, smooth_joined, smooth_long
from bayes_aero.physics.kinematics import (
    RATES,
    Rotation,
    across_flow,
    angular_accelerations,
    down_of,
    inertial_moments,
    lever_arm,
    motion_over_ground,
    side_force,
)

SMOOTHED = ("alpha", "beta", "airspeed")

Signals = dict[str, Float[AnyArray, "*#n"]]
Series = Float[AnyArray, " n"]
Index = Int[AnyArray, " n"]


def condition_joined(channels: Mapping[str, Series], dt: Series, first: Index, last: Index) -> Signals:
    """Signals smoothed and differentiated as published; manoeuvres end to end, `first` and `last` their ends."""
    signals = dict(channels)
    names = [name for name in SMOOTHED if name in signals]
    # One filter over all channels stacked compiles several times faster than one filter each.
    rows = _each(lambda x: smooth_joined(x, first, last), [signals[name] for name in (*names, *RATES)])
    signals |= dict(zip(names, rows, strict=False))
    return signals | _slopes(["alpha", *RATES], [signals["alpha"], *rows[len(names) :]], dt, first, last)


def unsmoothed_joined(
    channels: Mapping[str, AnyArray],
    accelerometer: tuple[Any, Any, Any],
    dt: Series,
    first: Index,
    last: Index,
    regression: LiftRegression | None = None,
) -> dict[str, AnyArray]:
    """Unsmoothed channels and the derivatives of `condition_joined`."""
    # The difference of measured and modelled coefficients is smoothed later: the filter acts on both sides alike, also
    # on non-linear terms, where the published method underestimates fast effects. alpha-dot is formed by `alpha_rate`,
    # because its noise would bias non-linear models; its `regression` is that of the uncorrected channels, or of these.
    signals = dict(channels) | _slopes(RATES, [channels[name] for name in RATES], dt, first, last)
    regression = regression or lift_regression(channels, accelerometer, dt, first, last)
    return signals | {"alpha_dot": alpha_rate(signals, regression, dt, first, last)}


def alike_joined(
    channels: Mapping[str, AnyArray], accelerometer: tuple[Any, Any, Any], dt: Series, first: Index, last: Index
) -> Signals:
    """Every channel smoothed by the one filter, with these derivatives."""
    # The filter is linear: a coefficient that is a sum of terms is, once filtered, the sum of its filtered terms.
    raw = unsmoothed_joined(channels, accelerometer, dt, first, last)
    names = [*channels, "alpha_dot"]
    smoothed = _each(lambda x: smooth_joined(x, first, last), [raw[n] for n in names])
    signals = dict(zip(names, smoothed, strict=True))
    return signals | _slopes(RATES, [signals[n] for n in RATES], dt, first, last)


def _slopes(names: Sequence[str], rows: Sequence[AnyArray], dt: Series, first: Index, last: Index) -> Signals:
    slopes = _each(lambda x: differentiate_joined(x, dt, first, last), rows)
    return {f"{name}_dot": x for name, x in zip(names, slopes, strict=True)}


def coefficients(signals: Mapping[str, Float[AnyArray, "*n"]], aircraft: Aircraft) -> dict[str, Float[AnyArray, "*n"]]:
    """Coefficients from conditioned signals, sample by sample; the lateral ones only with `ay`."""
    # CL and CD are in stability axes, CY along body y, moments about body axes through the aerodynamic reference point.
    # `thrust` (total, net, N) at `aircraft.engine` is taken out, with the moments of `thrust_left` and `thrust_right`.
    s, a = signals, aircraft
    rotation = Rotation(s["p"], s["q"], s["r"], s["p_dot"], s["q_dot"], s["r_dot"])
    arm_x, arm_y, arm_z = lever_arm(rotation, a.accelerometer)
    (thrust_x, thrust_z), thrust_moments = thrust_of(s, a)
    pressure_area = 0.5 * s["density"] * jnp.square(s["airspeed"]) * a.wing_area
    CX = (a.mass * (s["ax"] - arm_x) - thrust_x) / pressure_area
    CZ = (a.mass * (s["az"] - arm_z) - thrust_z) / pressure_area
    CL, CD = across_flow(CX, CZ, s["alpha"])
    L, M, N = (i - t for i, t in zip(inertial_moments(rotation, a), thrust_moments, strict=True))
    x, y, z = a.reference_point
    longitudinal = {"CL": CL, "CD": CD, "Cm": M / (pressure_area * a.chord) - CX * z / a.chord + CZ * x / a.chord}
    if "ay" not in s:
        return longitudinal
    b, CY = a.moment_length, a.mass * (s["ay"] - arm_y) / pressure_area
    Cl = L / (pressure_area * b) - CZ * y / b + CY * z / b
    Cn = N / (pressure_area * b) - CY * x / b + CX * y / b
    return longitudinal | {"CY": CY, "Cl": Cl, "Cn": Cn}


def stacked_coefficients(
    signals: Mapping[str, Float[AnyArray, "*n"]], aircraft: Aircraft, names: Sequence[str] = NAMES
) -> Float[AnyArray, "*n c"]:
    """`coefficients` of these names, along the last axis."""
    formed = coefficients(signals, aircraft)
    return jnp.stack([formed[name] for name in names], axis=-1)


# --- Forces and moments from coefficients; the inverse of `coefficients`.
# Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 3.


def thrust_components(thrust: Samples, aircraft: Aircraft) -> tuple[Samples, Samples]:
    """Thrust along body x and z, N."""
    return thrust * jnp.cos(aircraft.engine_inclination), -thrust * jnp.sin(aircraft.engine_inclination)


def thrust_of(
    signals: Mapping[str, Samples], aircraft: Aircraft
) -> tuple[tuple[Samples, Samples], tuple[Samples, Samples, Samples]]:
    """Thrust along body x and z (N), and its moments about the CG (N m): with those of a left and a right engine."""
    along, down = thrust_components(signals["thrust"], aircraft)
    x, y, z = aircraft.engine
    roll, pitch, yaw = y * down, z * along - x * down, -y * along
    if "thrust_left" in signals and "thrust_right" in signals:
        apart = thrust_components(signals["thrust_left"] - signals["thrust_right"], aircraft)
        roll, yaw = roll - aircraft.engine_arm * apart[1], yaw + aircraft.engine_arm * apart[0]
    return (along, down), (roll, pitch, yaw)


def specific_force(
    CL: Samples, CD: Samples, alpha: Samples, pressure: Samples, thrust: Samples, aircraft: Aircraft
) -> tuple[Samples, Samples]:
    """Aerodynamics and thrust along body x and z over the mass, m/s2; `pressure` is dynamic, Pa."""
    CX, CZ = across_flow(CL, CD, alpha)
    x, z = thrust_components(thrust, aircraft)
    force = pressure * aircraft.wing_area
    return (force * CX + x) / aircraft.mass, (force * CZ + z) / aircraft.mass


def moments(
    flow: Mapping[str, Samples],
    force: tuple[Samples, Samples, Samples],
    signals: Mapping[str, Samples],
    aircraft: Aircraft,
) -> tuple[Samples, Samples, Samples]:
    """Moments of aerodynamics and engines about body axes through the centre of gravity, N m."""
    # `flow`: Cl, Cm, Cn about the reference point; `force`: specific, at the CG, m/s2, of which thrust is taken out;
    # `signals`: air and thrust.
    a = aircraft
    area = 0.5 * signals["density"] * jnp.square(signals["airspeed"]) * a.wing_area
    (along, down), (roll, pitch, yaw) = thrust_of(signals, a)
    X, Y, Z = a.mass * force[0] - along, a.mass * force[1], a.mass * force[2] - down
    x, y, z = a.reference_point
    L = area * a.moment_length * flow["Cl"] + y * Z - z * Y + roll
    M = area * a.chord * flow["Cm"] + z * X - x * Z + pitch
    N = area * a.moment_length * flow["Cn"] + x * Y - y * X + yaw
    return L, M, N


# --- Rate of change of the angle of attack from vane, gyro and accelerometer, with noise independent of that of lift.
# Newton's law normal to the flight path: alpha-dot is the pitch rate less the rotation of the path by specific force
# and gravity.

KNOTS = (0.4, 0.6, 0.75, 0.85, 0.93)  # shares of the samples at lower alpha; dense where the flow separates
ITERATIONS = 2  # of the regression, because the hysteresis depends on alpha-dot
RIDGE = 1e-6  # of the mean square of a column


class LiftRegression(NamedTuple):
    """Regression of the part of alpha-dot due to specific force on the variables on which lift depends."""

    share: Float[AnyArray, " c"]  # coefficients of the regressors (see `_causes`)
    knots: Float[AnyArray, " j"]  # rad
    before: Series  # part of alpha-dot due to specific force, rad/s, of which the hysteresis was computed


def alpha_rate(s: Mapping[str, AnyArray], regression: LiftRegression, dt: Series, first: Index, last: Index) -> Series:
    """alpha-dot, rad/s, of manoeuvres laid end to end: slow part from the vane, fast part from gyro and lift."""
    # The differentiated noise of a vane is several times that of gyro and accelerometer, and a one-sided hysteresis
    # turns it into a bias. The measured part due to specific force is the measured lift; as a regressor of the lift
    # coefficient it would explain the noise of the lift. It is therefore regressed on the variables on which lift
    # depends (angle of attack in pieces, their hysteresis, elevator, pitch rate), and the prediction is used: two-stage
    # least squares. Near the ends only the smoothed vane is used. `regression` is that of the uncorrected record.
    # Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10 (kinematics); Wooldridge, *Econometric
    # Analysis of Cross Section and Panel Data*, 2010, ch. 5 (two-stage least squares).
    smooth, fast, base = _parts(s, dt, first, last)
    raw = regression.share @ _causes(s, base + regression.before, regression.knots)
    return base + fast(raw, smooth(raw))


def lift_regression(
    s: Mapping[str, AnyArray], accelerometer: tuple[Any, Any, Any], dt: Series, first: Index, last: Index
) -> LiftRegression:
    """Regression of the fast part of alpha-dot due to specific force on the causes of lift; see `alpha_rate`."""
    lib = namespace(*s.values())
    smooth, fast, base = _parts(s, dt, first, last)
    names = [name for name in ("alpha", "q", "airspeed", "density", "elevator") if name in s]
    smoothed = dict(zip(names, _each(smooth, [s[name] for name in names]), strict=True))
    turning = [s[name] for name in RATES]
    rotation = Rotation(*turning, *_each(lambda x: differentiate_joined(x, dt, first, last), turning))
    arm_x, _, arm_z = lever_arm(rotation, accelerometer)
    at_cg = (s["az"] - arm_z) * lib.cos(s["alpha"]) - (s["ax"] - arm_x) * lib.sin(s["alpha"])
    forced = smooth(at_cg / s["airspeed"])  # the part of alpha-dot due to specific force at the CG
    response = fast(forced, forced)
    knots = lib.quantile(smoothed["alpha"], np.array(KNOTS))
    before = part = lib.zeros_like(base)
    share = lib.zeros(0)
    for _ in range(ITERATIONS):
        causes = _causes(smoothed, smooth(base + part), knots)
        even = _each(lambda x: fast(x, x), causes)
        size = lib.sqrt(lib.mean(even**2, axis=1) + 1e-30)
        gram = even @ even.T / lib.outer(size, size) / even.shape[1]
        right = even @ response / size / even.shape[1]
        share = lib.linalg.solve(gram + RIDGE * np.eye(len(size)), right) / size
        raw = share @ _causes(s, base + part, knots)
        before, part = part, fast(raw, smooth(raw))
    return LiftRegression(share, knots, before)


def _each(work: Callable[[Series], Series], rows: Sequence[AnyArray] | AnyArray) -> AnyArray:
    """`work` on every row: by JAX in one program, which compiles several times faster than one for each."""
    if namespace(*rows) is np:
        return np.stack([work(row) for row in rows])
    return jax.vmap(work)(jnp.stack(list(rows)))


def _parts(
    s: Mapping[str, AnyArray], dt: Series, first: Index, last: Index
) -> tuple[Callable[[Series], Series], Callable[[AnyArray, AnyArray], AnyArray], Series]:
    """The smoothing filter, the high-pass filter, and alpha-dot without the part due to specific force."""

    smooth = partial(smooth_joined, first=first, last=last)
    vane = smooth(s["alpha"])
    alone, long = (differentiate_joined(x, dt, first, last) for x in (vane, smooth_long(vane)))
    inside = inside_joined(vane.shape[0], first, last) >= LONG_REACH

    def fast(x, smoothed):
        return xp.where(inside, x - smooth_long(smoothed), 0.0)

    turning = s["q"]
    if "beta" in s:
        turning = turning - (s["p"] * xp.cos(s["alpha"]) + s["r"] * xp.sin(s["alpha"])) * xp.tan(s["beta"])
    return smooth, fast, xp.where(inside, long, alone) + fast(turning, smooth(turning))


def _causes(s: Mapping[str, AnyArray], rate: Series, knots: Float[AnyArray, " j"]) -> Float[AnyArray, "c n"]:
    """Regressors of lift over mass and airspeed, as rows."""
    weight = s["density"] * s["airspeed"]
    pieces = xp.maximum(s["alpha"] - knots[:, None], 0.0)
    falling = xp.minimum(rate, 0.0)
    rows = [s["alpha"][None], pieces, falling[None], falling * pieces, s["q"][None]]
    if "elevator" in s:
        rows.append(s["elevator"][None])
    return weight * namespace(*rows).concatenate(rows)


# --- Equations of motion at one instant: from the flow's coefficients to the motion of the aircraft.
# Six degrees of freedom, of which any may be prescribed. Flat earth. Sources: Etkin and Reid, *Dynamics of Flight*,
# 3rd ed. 1996, ch. 4; Klein and Morelli, *Aircraft System Identification*, 2006, ch. 3.

TOLERANCE = 1e-12  # rad/s, of alpha-dot
MIN_SLOPE = 0.1  # of the equation of alpha-dot; at zero the motion is not unique
MAX_ITERATIONS = 60  # iterations: bisection alone would need 50
LONGITUDINAL = (Axis.LONGITUDINAL,)


class AircraftMotion(NamedTuple):
    """Motion at one instant."""

    flow: Mapping[str, Any]  # coefficients and other quantities of the effects
    force: tuple[Any, Any, Any]  # specific force at the CG along body axes, m/s2
    rates: Mapping[str, Any]  # time derivatives of airspeed (m/s2), alpha, beta (rad/s) and altitude (m/s)
    rotation: tuple[Any, Any, Any]  # p_dot, q_dot, r_dot, rad/s2

    @property
    def q_dot(self) -> Any:
        """Pitch acceleration, rad/s2."""
        return self.rotation[1]


def motion_of_aircraft(
    flow: Callable[[Any], Mapping[str, Any]],
    air: Mapping[str, Any],
    path: Mapping[str, Any],
    aircraft: Aircraft,
    *,
    implicit: bool,
    axes: Collection[Axis] = LONGITUDINAL,
    prescribed: Collection[str] = ("p", "r"),
) -> AircraftMotion:
    """Forces, moments and the motion that follows."""
    # Forces of `axes` are those of the flow. Others are given: in the plane of symmetry as `force_x` and `force_z`; the
    # lateral one follows from `ay` at the accelerometer, else from the sideslip's rate `beta_dot`, else it is 0. `flow`
    # gives the coefficients and other quantities of the effects as a function of alpha-dot in rad/s, on which they
    # depend where `implicit`. `air`: `alpha`, `airspeed`, `density` of the flow, `thrust`. `path`: the motion over
    # ground: `airspeed`, `alpha`, `beta`, rates, `theta` and `phi` or `down`. `prescribed`: those of `p`, `q`, `r`
    # whose acceleration `path` gives (else 0), and `alpha`, if it gives `alpha_dot`.
    nothing = jnp.zeros_like(air["alpha"])
    pressure = 0.5 * air["density"] * jnp.square(air["airspeed"])
    down = path["down"] if "down" in path else down_of(path["phi"], path["theta"])

    def forces(modelled: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        if Axis.LONGITUDINAL in axes:
            fx, fz = specific_force(modelled["CL"], modelled["CD"], air["alpha"], pressure, air["thrust"], aircraft)
        else:
            fx, fz = path["force_x"], path["force_z"]
        if Axis.LATERAL in axes:
            return fx, pressure * aircraft.wing_area * modelled["CY"] / aircraft.mass, fz
        if "ay" in path:
            p_dot, q_dot, r_dot = (path.get(f"{n}_dot", nothing) for n in RATES)
            spin = Rotation(path["p"], path["q"], path["r"], p_dot, q_dot, r_dot)
            return fx, path["ay"] - lever_arm(spin, aircraft.accelerometer)[1], fz  # q-dot does not enter it
        return fx, side_force(path, fx, fz) if "beta_dot" in path else nothing, fz

    if "alpha" in prescribed:
        rate = path["alpha_dot"]
    elif implicit:
        rate = alpha_dot(lambda rate: motion_over_ground(path, forces(flow(rate)), down)["alpha"])
    else:
        rate = None
    quantities = flow(nothing if rate is None else rate)
    force = forces(quantities)
    rates = motion_over_ground(path, force, down)
    rates |= {} if rate is None else {"alpha": rate}
    given = {f"{n}_dot": path.get(f"{n}_dot", nothing) for n in RATES if n in prescribed}
    acting = moments(quantities, force, air, aircraft)
    rotation = angular_accelerations(acting, tuple(path[n] for n in RATES), aircraft, given)  # type: ignore[arg-type]
    return AircraftMotion(quantities, force, rates, rotation)


def accelerometers(now: AircraftMotion, path: Mapping[str, Any], aircraft: Aircraft) -> dict[str, Any]:
    """Specific force at the accelerometers, m/s2; `path` has the rates p, q, r."""
    p_dot, q_dot, r_dot = now.rotation
    arm = lever_arm(Rotation(path["p"], path["q"], path["r"], p_dot, q_dot, r_dot), aircraft.accelerometer)
    return {name: f + x for name, f, x in zip(("ax", "ay", "az"), now.force, arm, strict=True)}


def alpha_dot(rate_of: Callable[[Any], Any]) -> Float[AnyArray, ""]:
    """Solve rate = rate_of(rate), because lift depends on alpha-dot through the separation point."""
    # Usually the right side decreases with alpha-dot, and the root is between zero and rate_of(0). Where it increases
    # the root is beyond, and for a larger slope the motion is not unique: NaN. A fixed-point iteration would not
    # converge (gain 0.9 to 2.7). Derivatives are those of the implicit function.

    def bracketed(excess, first):
        def not_converged(state):
            _, _, _, step, _, count = state
            return (jnp.abs(step) > TOLERANCE) & (count < MAX_ITERATIONS)

        def iterate(state):
            low, high, rate, _, min_slope, count = state
            value, slope = jax.jvp(excess, (rate,), (jnp.ones_like(rate),))
            low, high = jnp.where(value < 0.0, rate, low), jnp.where(value > 0.0, rate, high)
            newton = rate - value / jnp.where(slope > 0.0, slope, 1.0)
            outside = (newton < low) | (newton > high) | ~(slope > 0.0)
            new = jnp.where(outside, 0.5 * (low + high), newton)
            return low, high, new, new - rate, jnp.minimum(slope, min_slope), count + 1

        infinite = jnp.full_like(first, jnp.inf)
        bound = first / MIN_SLOPE  # of the root, if the slope is nowhere smaller
        begin = (jnp.minimum(bound, 0.0), jnp.maximum(bound, 0.0), 0.5 * first, infinite, infinite, 0)
        _, _, rate, _, min_slope, _ = jax.lax.while_loop(not_converged, iterate, begin)
        return rate, min_slope

    first = rate_of(jnp.zeros(()))
    root = jax.lax.custom_root(
        lambda rate: rate - rate_of(rate), first, bracketed, lambda g, y: y / g(1.0), has_aux=True
    )
    rate, min_slope = root  # type: ignore[misc]
    return jnp.where(min_slope > MIN_SLOPE, rate, jnp.nan)
