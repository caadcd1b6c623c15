"""From recorded accelerations and rates to the coefficients of forces and moments.

Signals are conditioned in one of three ways. `condition_joined`: as the published ATTAS coefficients were formed:
alpha, beta, V smoothed; alpha-dot the derivative of smoothed alpha; p, q, r smoothed and differentiated for the angular
accelerations, unsmoothed where they enter kinematics. `alike_joined`: every channel smoothed alike.
`unsmoothed_joined`: none, where the difference of measured and modelled coefficients is smoothed later.
Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 12 and its companion data set.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bayes_aero.arrays import Samples, xp
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.physics.coefficient_names import NAMES
from bayes_aero.physics.filters import SMOOTHED_DERIVATIVE_GAIN, SMOOTHING_GAIN, differentiate_joined, smooth_joined
from bayes_aero.physics.flightpath import RATES, Rotation, inertial_moments, lever_arm
from bayes_aero.physics.incidence_rate import alpha_rate, lift_regression

SMOOTHED = ("alpha", "beta", "airspeed")

Signals = dict[str, Float[Array, "*#n"]]
Series = Float[Array, " n"]
Index = Int[Array, " n"]
Filter = Callable[[Series], Series]


class Coefficients(NamedTuple):
    """Coefficients, each of shape (n,): CL and CD in stability axes, CY along body y, moments about body axes through
    the aerodynamic reference point."""

    CL: Float[Array, "*n"]
    CD: Float[Array, "*n"]
    Cm: Float[Array, "*n"]
    CY: Float[Array, "*n"] | None = None
    Cl: Float[Array, "*n"] | None = None
    Cn: Float[Array, "*n"] | None = None


def condition_joined(channels: Mapping[str, Series], dt: Series, first: Index, last: Index) -> Signals:
    """Smoothed and differentiated signals, SI and radians, beside the untouched ones; manoeuvres laid end to end.
    `first` and `last` are the ends of each sample's own manoeuvre. Adds `alpha_dot`, `p_dot`, `q_dot`, `r_dot`
    (derivatives of the smoothed signals), replacing recorded ones."""
    signals = {name: jnp.asarray(values) for name, values in channels.items()}
    # One filter over all channels stacked compiles several times faster than one filter each.
    names = [name for name in SMOOTHED if name in signals]
    rows = jnp.stack([signals[name] for name in (*names, *RATES)])
    smoothed = jax.vmap(lambda x: smooth_joined(x, first, last))(rows)
    signals |= dict(zip(names, smoothed, strict=False))
    slopes = [signals["alpha"], *smoothed[len(names) :]]
    return signals | _slopes(slopes, lambda x: differentiate_joined(x, dt, first, last))


def unsmoothed_joined(
    channels: Mapping[str, Array],
    accelerometer: tuple[Any, Any, Any],
    dt: Series,
    first: Index,
    last: Index,
    recorded: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Unsmoothed channels, manoeuvres laid end to end, and the derivatives of `condition_joined`. The difference of
    measured and modelled coefficients is smoothed later, so that the filter acts on both sides alike, also on
    non-linear terms. The published method compares a smoothed pitch acceleration with an unsmoothed elevator, and the
    lift of a smoothed angle of attack with unsmoothed lift, so that fast effects are underestimated. Only alpha-dot is
    formed in another way, because its noise would bias non-linear models: see `alpha_rate`. `recorded` are the
    uncorrected channels, on which the regression of alpha-dot is based."""

    def with_slopes(given: Mapping[str, Array]) -> dict[str, Array]:
        rates = [given[name] for name in RATES]
        return dict(given) | _slopes(rates, lambda x: differentiate_joined(x, dt, first, last), RATES)

    signals = with_slopes(channels)
    reference = signals if recorded is None else with_slopes(recorded)
    regression = lift_regression(reference, accelerometer, dt, first, last)
    return signals | {"alpha_dot": alpha_rate(signals, regression, dt, first, last)}


def alike_joined(
    channels: Mapping[str, Array], accelerometer: tuple[Any, Any, Any], dt: Series, first: Index, last: Index
) -> Signals:
    """Every channel smoothed by the one filter, manoeuvres laid end to end, with the derivatives of `condition_joined`.
    The filter is linear, so a coefficient that is a sum of terms is, once filtered, the sum of its filtered terms:
    measured and modelled coefficients are filtered alike. alpha-dot: `alpha_rate`."""
    raw = unsmoothed_joined(channels, accelerometer, dt, first, last)
    names = [*channels, "alpha_dot"]
    smoothed = jax.vmap(lambda x: smooth_joined(x, first, last))(jnp.stack([jnp.asarray(raw[n], float) for n in names]))
    signals = dict(zip(names, smoothed, strict=True))
    return signals | _slopes([signals[n] for n in RATES], lambda x: differentiate_joined(x, dt, first, last), RATES)


def _slopes(rows: Sequence[Array], derivative: Filter, names: Sequence[str] = ("alpha", *RATES)) -> Signals:
    return {f"{name}_dot": x for name, x in zip(names, jax.vmap(derivative)(jnp.stack(rows)), strict=True)}


def coefficients(signals: Mapping[str, Float[Array, "*n"]], aircraft: Aircraft) -> Coefficients:
    """Coefficients from conditioned signals, sample by sample (so it may be differentiated or mapped sample by sample).
    `thrust` is the total net thrust in N, acting at `aircraft.engine`; it is removed from forces and moments, with the
    moments of `thrust_left` and `thrust_right` where both are there. Without `ay` the lateral ones are None."""
    s, a = signals, aircraft
    rotation = Rotation(s["p"], s["q"], s["r"], s["p_dot"], s["q_dot"], s["r_dot"])
    arm_x, arm_y, arm_z = lever_arm(rotation, a.accelerometer)
    thrust_x, thrust_z = thrust_components(s["thrust"], a)
    pressure_area = 0.5 * s["density"] * jnp.square(s["airspeed"]) * a.wing_area
    CX = (a.mass * (s["ax"] - arm_x) - thrust_x) / pressure_area
    CZ = (a.mass * (s["az"] - arm_z) - thrust_z) / pressure_area
    CL, CD = lift_drag_from_body(CX, CZ, s["alpha"])

    x_engine, y_engine, z_engine = a.engine
    x_ref, y_ref, z_ref = a.reference_point
    L, M, N = inertial_moments(rotation, a)
    M = M - (thrust_x * z_engine - thrust_z * x_engine)
    Cm = M / (pressure_area * a.chord) - CX * z_ref / a.chord + CZ * x_ref / a.chord
    if "ay" not in s:
        return Coefficients(CL, CD, Cm)

    b = a.moment_length
    CY = a.mass * (s["ay"] - arm_y) / pressure_area
    roll, yaw = engine_moments(s, a)
    L, N = L - y_engine * thrust_z - roll, N + y_engine * thrust_x - yaw
    Cl = L / (pressure_area * b) - CZ * y_ref / b + CY * z_ref / b
    Cn = N / (pressure_area * b) - CY * x_ref / b + CX * y_ref / b
    return Coefficients(CL, CD, Cm, CY, Cl, Cn)


def stacked_coefficients(
    signals: Mapping[str, Float[Array, "*n"]], aircraft: Aircraft, names: Sequence[str] = NAMES
) -> Float[Array, "*n c"]:
    """`coefficients` of these names, along the last axis."""
    found = coefficients(signals, aircraft)
    return jnp.stack([getattr(found, name) for name in names], axis=-1)


def coefficient_noise(
    signals: Mapping[str, Series],
    aircraft: Aircraft,
    sensor_sd: Mapping[str, float],
    dt: float | Series,
    smoothed: Collection[str] = SMOOTHED,
    names: Sequence[str] = NAMES,
) -> Float[Array, "n c"]:
    """Standard deviation of the coefficients `names` per sample from independent white sensor noise. `sensor_sd` are
    its deviations, SI. First order; `smoothed` names the channels that were smoothed. Smoothing and differentiation
    scale the noise by their weights' root sum of squares, which is exact away from the outer eight samples; a rate and
    the derivative of its smoothed self are uncorrelated at one sample because the one filter is even and the other
    odd."""
    noisy = {name: value for name, value in sensor_sd.items() if value != 0.0}
    sd: dict[str, Any] = {name: value * (SMOOTHING_GAIN if name in smoothed else 1.0) for name, value in noisy.items()}
    for name in ("p", "q", "r"):
        if name in noisy:
            sd[f"{name}_dot"] = noisy[name] * SMOOTHED_DERIVATIVE_GAIN / dt
    variance = 0.0
    for name, value in sd.items():
        if name not in signals:
            continue
        perturbed = {k: jnp.ones_like(v) if k == name else jnp.zeros_like(v) for k, v in signals.items()}
        _, slope = jax.jvp(lambda s: stacked_coefficients(s, aircraft, names), (dict(signals),), (perturbed,))
        variance = variance + jnp.square(slope * jnp.asarray(value)[..., None])
    return jnp.sqrt(jnp.broadcast_to(variance, (signals["alpha"].shape[0], len(names))))


# --- Rotations between body axes (x forward, y right, z down) and stability axes (lift and drag).


def lift_drag_from_body(CX: Samples, CZ: Samples, alpha: Samples) -> tuple[Samples, Samples]:
    """CL and CD from the body-axis force coefficients; `alpha` in rad. CL = CX sin alpha - CZ cos alpha, CD = -CX cos
    alpha - CZ sin alpha."""
    sin, cos = xp.sin(alpha), xp.cos(alpha)
    return CX * sin - CZ * cos, -CX * cos - CZ * sin


def body_from_lift_drag(CL: Samples, CD: Samples, alpha: Samples) -> tuple[Samples, Samples]:
    """CX and CZ from lift and drag; the inverse of `lift_drag_from_body`."""
    sin, cos = xp.sin(alpha), xp.cos(alpha)
    return CL * sin - CD * cos, -CL * cos - CD * sin


# --- Forces and moments from coefficients; the inverse of `coefficients`.
# Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 3.


def thrust_components(thrust: Samples, aircraft: Aircraft) -> tuple[Samples, Samples]:
    """Thrust along body x and z, N."""
    return thrust * jnp.cos(aircraft.engine_inclination), -thrust * jnp.sin(aircraft.engine_inclination)


def engine_moments(signals: Mapping[str, Samples], aircraft: Aircraft) -> tuple[Samples, Samples]:
    """Moments (N m) about body x and z of a left and a right engine `engine_arm` off the plane of symmetry. None where
    `thrust_left` and `thrust_right` (N) were not both recorded."""
    if "thrust_left" not in signals or "thrust_right" not in signals:
        nothing = jnp.zeros_like(signals["thrust"])
        return nothing, nothing
    along, down = thrust_components(signals["thrust_left"] - signals["thrust_right"], aircraft)
    return -aircraft.engine_arm * down, aircraft.engine_arm * along


def specific_force(
    CL: Samples, CD: Samples, alpha: Samples, pressure: Samples, thrust: Samples, aircraft: Aircraft
) -> tuple[Samples, Samples]:
    """Aerodynamics and thrust along body x and z over the mass, m/s2; `pressure` is dynamic, Pa."""
    CX, CZ = body_from_lift_drag(CL, CD, alpha)
    x, z = thrust_components(thrust, aircraft)
    force = pressure * aircraft.wing_area
    return (force * CX + x) / aircraft.mass, (force * CZ + z) / aircraft.mass


def moments(
    flow: Mapping[str, Samples],
    force: tuple[Samples, Samples, Samples],
    signals: Mapping[str, Samples],
    aircraft: Aircraft,
) -> tuple[Samples, Samples, Samples]:
    """Moments of aerodynamics and engines about body x, y and z through the centre of gravity, N m. `flow` has Cl, Cm,
    Cn about the aircraft's reference point; `force` is the specific force at the centre of gravity, body axes, m/s2, of
    which thrust is taken out. `signals`: `airspeed`, `density` and `thrust`, SI, with `thrust_left` and `thrust_right`
    where known."""
    a = aircraft
    area = 0.5 * signals["density"] * jnp.square(signals["airspeed"]) * a.wing_area
    along, down = thrust_components(signals["thrust"], a)
    X, Y, Z = a.mass * force[0] - along, a.mass * force[1], a.mass * force[2] - down
    x, y, z = a.reference_point
    x_engine, y_engine, z_engine = a.engine
    roll, yaw = engine_moments(signals, a)
    L = area * a.moment_length * flow["Cl"] + y * Z - z * Y + y_engine * down + roll
    M = area * a.chord * flow["Cm"] + z * X - x * Z + z_engine * along - x_engine * down
    N = area * a.moment_length * flow["Cn"] + x * Y - y * X - y_engine * along + yaw
    return L, M, N


def lateral_force(CY: Samples, pressure: Samples, aircraft: Aircraft) -> Samples:
    """Aerodynamics along body y over the mass, m/s2; `pressure` is dynamic, Pa."""
    return pressure * aircraft.wing_area * CY / aircraft.mass
