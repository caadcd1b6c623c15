"""Simulation of a model with a pilot at the controls, in three or six degrees of freedom, and flight-test inputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import brentq

from bayes_aero.dynamics import trim as steady
from bayes_aero.dynamics.aircraft import RigidBody
from bayes_aero.dynamics.flight import Values
from bayes_aero.dynamics.system import Row, System, advance, integrate, later
from bayes_aero.effect import Stage
from bayes_aero.model import observations as observations
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import DEFAULT_RANGES, GRAVITY, Aircraft, Axis, Envelope, air, excursion
from bayes_aero.physics.coefficients import accelerometers, motion_of_aircraft
from bayes_aero.physics.filters import differentiate
from bayes_aero.physics.kinematics import euler_rates
from bayes_aero.processes import compiled_at

# --- The simulated aircraft in three degrees of freedom: pilot, prescribed turn, and disturbances of the
# coefficients. Bank angle and sideslip are prescribed with their rates; the yaw rate follows from them (see
# `Plant.turn`). Flat earth, no wind. The equations of motion are those of `physics.coefficients`.


class FlightState(NamedTuple):
    """State of `Plant`; SI."""

    airspeed: Any
    alpha: Any
    theta: Any
    q: Any
    altitude: Any
    lagged_X: Any = 1.0  # the lagged separation point
    trim: Any = 0.0  # the pilot's trim command, rad


TURNING = {"phi": "phi_rate", "phi_rate": "phi_acceleration", "beta": "beta_dot", "beta_dot": "beta_acceleration"}
DISTURBED_COEFFICIENTS = ("CL", "CD", "Cm")


class Plant(System):
    """The aircraft with its model. Inputs: bank and sideslip with their derivatives, the commanded alpha `led_alpha`,
    the pilot's `command` in addition to feedback and trim, other controls, and disturbances `dCL`, `dCD`, `dCm` of the
    coefficients, which are multiplied by 1 + `buffet` (1 - X)."""

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    gains: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]  # on alpha, q and the integral of alpha
    buffet: Float[Array, ""]
    shares: Any = (1.0, 0.0)  # of the pilot's command in each of `CONTROLS`

    @property
    def states(self) -> tuple[str, ...]:
        return FlightState._fields

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        state = FlightState(*x)
        density, sound = air(state.altitude)
        s = dict(u) | {name: getattr(state, name) for name in ("airspeed", "alpha", "theta", "q", "altitude")}
        feedback = self.gains[0] * (state.alpha - u["led_alpha"]) + self.gains[1] * state.q
        command = u["command"] + feedback + state.trim
        s |= {"elevator": self.shares[0] * command, "stabilizer": u["stabilizer"] + self.shares[1] * command}
        s |= {"density": density, "mach": state.airspeed / sound}
        s |= self.turn(s)

        def flow(alpha_dot):
            known = s | {"alpha_dot": alpha_dot}
            static = self.model.static_separation(self.values, known, self.aircraft)
            X = jnp.where(self.model.lag(self.values) > 0.0, state.lagged_X, static)
            known = self.model.flow(self.values, known, self.aircraft, X=X)
            growth = 1.0 + self.buffet * (1.0 - X)
            return known | {"static_X": static} | {n: known[n] + growth * s[f"d{n}"] for n in DISTURBED_COEFFICIENTS}

        implicit = any("alpha_dot" in effect.channels for effect in self.model.acting)
        now = motion_of_aircraft(flow, s, s, self.aircraft, implicit=implicit)
        rates = {name: now.rates[name] for name in ("airspeed", "alpha", "altitude")} | {"q": now.q_dot}
        rates["theta"] = euler_rates((s["p"], s["q"], s["r"]), s["phi"], s["theta"])[1]
        lag = self.model.lag(self.values) * self.aircraft.chord / state.airspeed
        X_dot = jnp.where(lag > 0.0, (now.flow["static_X"] - state.lagged_X) / jnp.where(lag > 0.0, lag, 1.0), 0.0)
        derivative = FlightState(**rates, lagged_X=X_dot, trim=self.gains[2] * (state.alpha - u["led_alpha"]))
        change = rates | {name: u[rate] for name, rate in TURNING.items()}
        turning = jax.jvp(self.turn, ({name: s[name] for name in change},), (change,))[1]
        now = now._replace(rotation=(turning["p"], now.q_dot, turning["r"]))
        accelerations = accelerometers(now, s, self.aircraft)
        outputs = s | accelerations | {"alpha_dot": rates["alpha"], "q_dot": now.q_dot}
        return jnp.stack(derivative), outputs | {name: now.flow[name] for name in ("X", "CL", "CD", "Cm")}

    def turn(self, s: Mapping[str, Any]) -> dict[str, Any]:
        """Roll, yaw (body axes) and turn rate of a flight with this bank and sideslip, from the kinematic equations and
        the equation of side force. The latter is V (r cos alpha - p sin alpha + beta-dot) = g cos theta sin phi + Y/m
        with Y due to sideslip: without sideslip a coordinated turn. It neglects V-dot tan beta; the side force recorded
        by `ay` does not."""
        V, phi, theta, q = s["airspeed"], s["phi"], s["theta"], s["q"]
        side = 0.5 * air(s["altitude"])[0] * V * self.aircraft.wing_area * SIDE_FORCE * s["beta"] / self.aircraft.mass
        needed = GRAVITY * jnp.cos(theta) * jnp.sin(phi) / V + side - s["beta_dot"]
        sin, cos = jnp.sin(s["alpha"]), jnp.cos(s["alpha"])
        lean = jnp.cos(theta) / jnp.cos(phi)
        rolling = q * jnp.tan(phi) * cos + s["phi_rate"] * sin
        psi_dot = (needed + rolling) / (lean * cos + jnp.sin(theta) * sin)
        p, r = s["phi_rate"] - psi_dot * jnp.sin(theta), psi_dot * lean - q * jnp.tan(phi)
        return {"p": p, "r": r, "psi_dot": psi_dot}


SIDE_FORCE = -0.7  # 1/rad, CY per sideslip of a transport; our choice, it sets only the yaw rate in sideslip


class Pilot(NamedTuple):
    """Commands of a simulated flight: alpha follows `alpha` (rad) by trim + gains x errors + `excitation` (rad).
    `thrust` in N; `disturbance` (n, 3) times 1 + `buffet` (1 - X) is added to CL, CD, Cm. Bank `phi` and sideslip
    `beta` (rad) are prescribed and must be smooth, because they are differentiated. `stabilizer`, `rudder`, `aileron`,
    `spoiler`, `dlc`, `flap` (rad) act only through effects. `trim_gain` (1/s): feedback on the integral of alpha, as by
    trimming. `uneven`: the left engine's thrust less the right one's over their sum; it acts only on a rigid body.
    Arrays have one row per sample."""

    alpha: Float[Any, " n"]
    thrust: Float[Any, " n"]
    excitation: Float[Any, " n"] | float = 0.0
    disturbance: Float[Any, "n 3"] | float = 0.0
    alpha_gain: Float[Any, ""] | float = 0.7
    rate_gain: Float[Any, ""] | float = 0.2
    phi: Float[Any, " n"] | float = 0.0
    beta: Float[Any, " n"] | float = 0.0
    stabilizer: Float[Any, " n"] | float = 0.0
    rudder: Float[Any, " n"] | float = 0.0
    spoiler: Float[Any, " n"] | float = 0.0
    dlc: Float[Any, " n"] | float = 0.0
    flap: Float[Any, " n"] | float = 0.0
    buffet: Float[Any, ""] | float = 0.0
    trim_gain: Float[Any, ""] | float = 0.0
    aileron: Float[Any, " n"] | float = 0.0
    uneven: Float[Any, " n"] | float = 0.0


def fly(
    model: Model,
    values: Values,
    aircraft: Aircraft,
    pilots: Sequence[Pilot],
    starts: Sequence[FlightState | steady.RigidTrim],
    dt: float,
) -> list[dict[str, Float[np.ndarray, " n"]]]:
    """All signals of flights of one length by the names of recorded channels, and CL, CD, Cm, X; (n,), SI; NaN from
    where a flight breaks down. From a `RigidTrim` in six degrees of freedom, else in three. Inputs are linear between
    samples: held, they would lag their record by half a sample, which a diagnosis finds as a delay of the elevator."""
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    if isinstance(starts[0], steady.RigidTrim):
        return [_fly_rigid(model, values, aircraft, *row, dt) for row in zip(pilots, starts, strict=True)]  # type: ignore[arg-type]
    gains = [np.array([p.alpha_gain, p.rate_gain, p.trim_gain, p.buffet], float) for p in pilots]
    rows = zip(*(map(_signals, pilots), gains, (np.array(start, float) for start in starts)), strict=True)
    stacked = (jax.tree.map(lambda *x: np.stack(x), *row) for row in zip(*rows, strict=True))
    several = jax.tree.map(np.asarray, _fly_several(model, values, aircraft, *stacked, jnp.asarray(dt)))
    flights = [{name: x[k] for name, x in several.items()} for k in range(len(pilots))]
    return [flight | {f"thrust_{side}": 0.5 * flight["thrust"] for side in ("left", "right")} for flight in flights]


def _signals(pilot: Pilot) -> dict[str, Float[np.ndarray, " n"]]:
    """What a pilot commands at every sample, by the names of the simulation's inputs."""
    n = np.shape(pilot.alpha)[0]
    whole = lambda x: np.broadcast_to(np.asarray(x, float), n)  # noqa: E731
    u = {"time": np.zeros(n), "led_alpha": whole(pilot.alpha)}
    names = ("thrust", "uneven", "excitation", "phi", "beta", "stabilizer", "rudder", "aileron", "flap")
    u |= {name: whole(getattr(pilot, name)) for name in names}
    u |= {f"{name}_{side}": whole(getattr(pilot, name)) for name in ("spoiler", "dlc") for side in ("left", "right")}
    disturbance = np.broadcast_to(np.asarray(pilot.disturbance, float), (n, 3)).T
    return u | dict(zip((f"d{name}" for name in DISTURBED_COEFFICIENTS), disturbance, strict=True))


def _fly(model: Model, values: dict[str, Any], aircraft: Aircraft, u: dict[str, Any], gains: Any, start: Any, dt: Any):
    state = FlightState(*start)
    shares, command = steady.lead(model, values, aircraft, u["led_alpha"], state.airspeed, state.altitude)
    plant = Plant(model, values, aircraft, (gains[0], gains[1], gains[2]), gains[3], shares)
    for name, rate in TURNING.items():
        u = u | {rate: differentiate(u[name], dt)}
    u |= {"time": jnp.arange(len(command)) * dt, "command": command + u["excitation"]}
    flown = integrate(plant, start, u, dt)
    turn = flown.outputs["psi_dot"]
    psi = jnp.cumsum(jnp.pad(0.5 * dt * (turn[1:] + turn[:-1]), (1, 0)))
    return {name: jnp.where(flown.inside, x, jnp.nan) for name, x in (flown.outputs | {"psi": psi}).items()}


_fly_several = compiled_at(0)(eqx.filter_vmap(_fly, in_axes=(None, None, None, 0, 0, 0, None)))


# --- Flights through random gusts: a system whose states include gusts, driven by their white noise.


def through_gusts(
    system: System,
    start: Float[Array, " s"],
    inputs: Mapping[str, Float[Any, " n"]],
    dt: Any,
    white: Float[Array, "n s"],
    outputs: Sequence[str],
    substeps: int = 1,
) -> tuple[Float[Array, "n c"], Bool[Array, " n"]]:
    """Outputs of one flight, and whether each sample was reached inside the envelope; `white`: normal numbers. A random
    process of decay rate a and spectral density q gains the variance q (1 - exp(-2 a dt)) / (2 a) in a sample, so that
    its own distribution is exact; within the sample the other states see its mean."""
    bounds = [system.envelope.get(name, (-jnp.inf, jnp.inf)) for name in system.states]
    lower, upper = (jnp.array([b[i] for b in bounds]) for i in (0, 1))

    def one_sample(x, row):
        now, then, noise = row
        rate = 2.0 * system.decay(x, now)
        gained = system.noise_density(x, now) * jnp.where(rate > 0.0, -jnp.expm1(-rate * dt) / rate, dt)
        outputs_now = system.motion(x, now)[1]
        outputs_now |= {name: x[i] for i, name in enumerate(system.states) if name in system.state_outputs}
        sound = jnp.all(jnp.isfinite(x)) & jnp.all((x >= lower) & (x <= upper))
        after = advance(system, x, now, then, dt, substeps) + jnp.sqrt(gained) * noise
        return after, (jnp.stack([outputs_now[name] for name in outputs]), sound)

    _, (made, sound) = jax.lax.scan(one_sample, start, (dict(inputs), later(inputs), white))
    return made, jnp.cumsum(~sound) == 0


# --- Simulation of a model in six degrees of freedom: controls about a trim, with a pilot who controls alpha, bank,
# sideslip. The same `Pilot` as in three degrees of freedom; bank and sideslip are commanded here, not prescribed. Flat
# earth, no wind.

BANK, ROLL, SLIP, YAW = 0.6, 0.5, 0.5, 0.7  # aileron per bank and roll rate, rudder per sideslip and yaw rate; s
LATERAL_CONTROLS = ("aileron", "rudder")
MAX_SUBSTEPS = 16  # integration steps a sample, for a separation point with a short lag
MAX_DEFLECTION = 0.5  # rad of any control
REFERENCE_SIDESLIP = 0.05  # rad, of the steady sideslip that gives the controls per sideslip


class PilotedBody(RigidBody):
    """A rigid body with feedback of its state to the controls; the pilot's pitch trim, rad, is a further state. The
    disturbance is multiplied by 1 + `buffet` (1 - X)."""

    gains: Any = (0.0, 0.0, 0.0)  # of the elevator on alpha, q and the integral of alpha
    buffet: Any = 0.0
    pilots: tuple[tuple[str, str, float], ...] = eqx.field(static=True, default=())  # moment, its control, its sign

    @property
    def after(self) -> tuple[str, ...]:
        names = super().after
        points = len(names) - len(self.points)
        return (*names[:points], "trim", *names[points:])

    def separation_rates(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> list[Any]:
        return [self.gains[2] * (state["alpha"] - s["led_alpha"]), *super().separation_rates(state, s)]

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        return super().flow_signals(x, dict(u) | self._controls(self.named(x), u))

    def flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        known = super().flow(state, s)
        growth = 1.0 + self.buffet * (1.0 - known["X"])
        return known | {name: known[name] + growth * s[f"d{name}"] for name in DISTURBED_COEFFICIENTS}

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        rates, outputs = super().motion(x, u)
        return rates, outputs | self._controls(self.named(x), u)

    def _controls(self, state: Mapping[str, Any], u: Row) -> dict[str, Any]:
        errors = {name: state[name] - u[f"led_{name}"] for name in ("alpha", "beta", "phi")}
        pitch = -self.gains[0] * errors["alpha"] - self.gains[1] * state["q"] - state["trim"]
        roll = -BANK * errors["phi"] - ROLL * state["p"]
        yaw = SLIP * errors["beta"] - YAW * (state["r"] - u["led_r"])
        commands = {"Cm": pitch, "Cl": roll, "Cn": yaw}
        deflections = {control: sign * commands[moment] for moment, control, sign in self.pilots}
        names = (*steady.CONTROLS, *LATERAL_CONTROLS)
        return {
            n: u[n] + jnp.clip(deflections[n], -MAX_DEFLECTION, MAX_DEFLECTION) if n in deflections else u[n]
            for n in names
        }


def _fly_rigid(
    model: Model, values: dict[str, Any], aircraft: Aircraft, pilot: Pilot, trim: steady.RigidTrim, dt: float
) -> dict[str, Float[np.ndarray, " n"]]:
    lag = float(model.lag(values))
    if lag == 0.0:  # a separation point without lag is no state
        model = Model.of([e for e in model.effects if e.stage is not Stage.LAG], axes=model.axes)
    speed, chosen = trim.state["airspeed"], steady.control_signs(model, values, aircraft, trim.state["airspeed"])
    pilots = tuple((moment, control, sign) for moment, (control, sign) in chosen.items())
    gains = tuple(jnp.asarray(x, float) for x in (pilot.alpha_gain, pilot.rate_gain, pilot.trim_gain))
    body = PilotedBody(model, values, aircraft, gains=gains, buffet=jnp.asarray(pilot.buffet, float), pilots=pilots)
    u = _signals(pilot)
    u["time"] = dt * np.arange(len(u["thrust"]))
    u |= {"led_beta": u.pop("beta"), "led_phi": u.pop("phi"), "elevator": np.zeros_like(u["thrust"])}
    u["led_r"] = GRAVITY / speed * np.sin(u["led_phi"])  # of a coordinated turn
    u |= {f"thrust_{n}": 0.5 * u["thrust"] * (1.0 + f * u["uneven"]) for n, f in (("left", 1.0), ("right", -1.0))}
    pitch, sign = chosen.get("Cm", ("elevator", -1.0))
    u[pitch] = u[pitch] - sign * u["excitation"]  # a positive command pitches down
    sideslipping: Mapping[str, float] = trim.controls
    if np.any(u["led_beta"]):
        condition = steady.Condition(speed, trim.state["altitude"], trim.state["beta"] + REFERENCE_SIDESLIP)
        sideslipping = steady.rigid_trim(model, values, aircraft, condition).controls
    for name in (*steady.CONTROLS, *LATERAL_CONTROLS):
        held = trim.controls.get(name, 0.0)
        per_sideslip = (sideslipping.get(name, 0.0) - held) / REFERENCE_SIDESLIP if name in LATERAL_CONTROLS else 0.0
        u[name] = u[name] + held + per_sideslip * u["led_beta"]
    inputs = {name: jnp.asarray(x) for name, x in u.items()}
    start = jnp.array([trim.state.get(name, 0.0) for name in body.start])
    start = body.state_at_start(body.complete_start(start, {name: x[0] for name, x in inputs.items()}))
    fast = lag * float(aircraft.chord) / speed
    parts = int(np.clip(np.ceil(2.0 * dt / fast), 1, MAX_SUBSTEPS)) if lag > 0.0 else 1
    trajectory = _integrate(body, start, inputs, jnp.asarray(dt), parts)
    flight = {name: np.asarray(x) for name, x in (inputs | trajectory.outputs).items()}
    density, sound = (np.asarray(x) for x in air(trajectory.outputs["altitude"]))
    flight |= {"density": density, "mach": flight["airspeed"] / sound}
    flight |= {name: np.unwrap(flight[name]) for name in ("phi", "psi")}
    flight |= {"aileron_left": -flight["aileron"], "aileron_right": flight["aileron"]}
    return {name: np.where(trajectory.inside, x, np.nan) for name, x in flight.items()}


_integrate = compiled_at(0)(integrate)


# --- Flight-test inputs: their shapes, and the standard inputs, simulated from steady.trimmed level flight.
# Their excitation: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 9; Jategaonkar, *Flight Vehicle
# System Identification*, 2nd ed. 2015, ch. 2. Amplitudes are our choice: those of a transport in a flight test.

SECONDS = 60.0  # s, of every manoeuvre, so that one compiled function serves all
RUN_IN = 5.0  # s of simulation before the record starts
TIGHT, LOOSE = (0.7, 0.2, 0.15), (0.05, 0.0, 0.0)  # elevator gains on alpha, q and the integral of alpha
STALL_BEYOND, STALL_RISE = np.deg2rad(2.0), np.deg2rad(8.0)  # beyond alpha*, or beyond trim without separation
SETTLE, WHOLE = 3.0, 10.0  # s recorded at least after the last input, and s of which a record is a multiple
MULTISINE, MULTISINE_BAND = (5.0, 25.0, 2), (0.1, 1.4)  # begin and period, s, number of periods; Hz
ANYWHERE = Envelope()
LATERAL = ("aileron_doublet", "rudder_doublet", "stall_with_bank", "engine_steps")  # those of the lateral axis
EXCITED_CHANNELS = {  # in addition to elevator and thrust; the aileron in six degrees of freedom
    "stabilizer_steps": "stabilizer", "sideslip": "beta", "bank_to_bank": "phi", "aileron_doublet": "aileron",
    "rudder_doublet": "rudder", "engine_steps": "thrust_left", "multisine": "aileron",
}  # fmt: skip

Series = Float[np.ndarray, " n"]
Pulse = tuple[float, float, float]  # begin and end, s, and level


def pulses(time: Series, parts: Iterable[Pulse]) -> Series:
    """Levels held from begin to end, zero between; a later part replaces an earlier one."""
    signal = np.zeros_like(time)
    for begin, end, level in parts:
        signal[(time >= begin) & (time < end)] = level
    return signal


def steps(*points: tuple[float, float]) -> list[Pulse]:
    """Pulses of levels held from each time (s) on."""
    return [(begin, np.inf, level) for begin, level in points]


def three_two_one_one(begin: float, unit: float, size: float) -> list[Pulse]:
    """Pulses of a 3-2-1-1 with `unit` s a step."""
    edges = begin + np.round(unit * np.array([0.0, 3.0, 5.0, 6.0, 7.0]), 9)  # 3 x 0.8 is not 2.4, where a sample may be
    return [(a, b, sign * size) for a, b, sign in zip(edges, edges[1:], (1.0, -1.0, 1.0, -1.0), strict=False)]


def ramps(time: Series, points: Iterable[tuple[float, float]]) -> Series:
    """Straight lines between (time s, level)."""
    return np.interp(time, *np.array(list(points)).T)


def rounded(signal: Series, seconds: float, dt: float) -> Series:
    """Convolved with a Hann window of this length, as by an actuator; held constant beyond the ends."""
    window = np.hanning(round(seconds / dt) | 1)
    window = window if len(window) > 2 else np.ones(1)
    padded = np.pad(signal, len(window) // 2, mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")


def commands(
    time: Series,
    trim: steady.Trim,
    stall: float,
    bank_per_sideslip: float,
    amplitude: float = 1.0,
    lateral: bool = False,
) -> dict[str, Pilot]:
    """The standard inputs by name: `stall` (rad) is the rise of alpha of the slow sweep above trim; with `lateral`
    those of aileron, rudder and unequal engines, a stall in banked flight, and multisines on three controls."""
    rest, dt, deg = np.zeros_like(time), float(time[1] - time[0]), np.pi / 180.0

    def held(smooth: float, *points: tuple[float, float], unit: float = deg) -> Series:
        return rounded(amplitude * unit * pulses(time, steps(*points)), smooth, dt)

    def doublets(size: float, *begins: tuple[float, float]) -> Series:
        """Of half a period each; begin and half period in s."""
        return held(0.4, *(p for t, half in begins for p in ((t, size), (t + half, -size), (t + 2.0 * half, 0.0))))

    def pilot(gains: tuple[float, ...], alpha: Series = rest, thrust: Series = rest, **signals: Series) -> Pilot:
        feedback = dict(zip(("alpha_gain", "rate_gain", "trim_gain"), gains, strict=True))
        return Pilot(trim.alpha + alpha, trim.thrust * np.maximum(1.0 + thrust, 0.1), **feedback | signals)

    multistep = [pulse for t in (5.0, 32.0) for pulse in three_two_one_one(t, 0.8, 2.0 * deg)]
    sideslip = held(4.0, (5.0, 5.0), (20.0, -5.0), (35.0, 0.0))
    bank = held(5.0, (5.0, 30.0), (20.0, -30.0), (35.0, 30.0), (50.0, 0.0))
    power = held(1.5, (5.0, 0.6), (18.0, -0.6), (35.0, 0.6), (48.0, 0.0), unit=1.0)
    sweep = [(0.0, 0.0), (5.0, 0.0), (32.0, stall), (35.0, stall), (39.0, 0.3 * stall), (45.0, stall), (52.0, 0.0)]
    idle = amplitude * ramps(time, [(0.0, 0.0), (5.0, 0.0), (7.0, -0.6)])
    elevator, *others = amplitude * deg * multisine_inputs(time, 3 if lateral else 1)
    pilots = {
        "elevator_doublet": pilot(LOOSE, excitation=doublets(2.5, (5.0, 1.5), (32.0, 1.5))),
        "elevator_3211": pilot(LOOSE, excitation=rounded(amplitude * pulses(time, multistep), 0.4, dt)),
        "multisine": pilot(LOOSE, excitation=2.0 * elevator),
        "slow_stall": pilot(TIGHT, alpha=amplitude * ramps(time, sweep), thrust=idle),
        "thrust_steps": pilot(TIGHT, thrust=power),
        "sideslip": pilot(TIGHT, beta=sideslip, phi=bank_per_sideslip * sideslip),
        "bank_to_bank": pilot(TIGHT, phi=bank),
        "stabilizer_steps": pilot(TIGHT, stabilizer=held(2.0, (5.0, 1.0), (22.0, -1.0), (40.0, 0.0))),
        "speed_change": pilot(LOOSE, excitation=held(1.0, (5.0, 1.0), (12.0, 0.0))),
    }
    if lateral:
        begins = (5.0, 1.0), (20.0, 2.0), (40.0, 1.0)
        uneven = held(1.5, (5.0, 0.3), (20.0, -0.3), (35.0, 0.3), (50.0, 0.0), unit=1.0)  # share of the thrust
        banked = held(4.0, (10.0, 15.0), (25.0, -15.0), (41.0, 15.0), (52.0, 0.0))
        pilots |= {
            "aileron_doublet": pilot(LOOSE, aileron=doublets(5.0, *begins)),
            "rudder_doublet": pilot(LOOSE, rudder=doublets(3.0, *begins)),
            "multisine": pilot(LOOSE, excitation=2.0 * elevator, aileron=5.0 * others[0], rudder=3.0 * others[1]),
            "stall_with_bank": pilots["slow_stall"]._replace(phi=banked),
            "engine_steps": pilot(LOOSE, uneven=uneven),
        }
    return pilots


def multisine_inputs(time: Series, controls: int) -> Float[np.ndarray, "c n"]:
    """Multisines with a peak of 1 on several controls: whole periods from `MULTISINE[0]` s on, zero elsewhere."""
    begin, period, count = MULTISINE
    inside = (time >= begin) & (time < begin + count * period)
    return np.where(inside, multisines(time - begin, period, MULTISINE_BAND, controls), 0.0)


def standard_pilots(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    time: Series,
    level: steady.Condition,
    amplitude: float = 1.0,
) -> tuple[dict[str, Pilot], FlightState | steady.RigidTrim]:
    """The pilot of each manoeuvre, and the level flight in which all start; `InputError` where there is no trim."""
    start: FlightState | steady.RigidTrim
    if rigid := Axis.LATERAL in model.axes:
        start = steady.rigid_trim(model, values, aircraft, level)
        sideslipping = steady.rigid_trim(model, values, aircraft, level._replace(sideslip=REFERENCE_SIDESLIP))
        bank_per_sideslip = (sideslipping.state["phi"] - start.state["phi"]) / REFERENCE_SIDESLIP
        trim = steady.Trim(start.state["alpha"], start.thrust, 0.0)
    else:
        trim = steady.trimmed(model, values, aircraft, level.airspeed, level.altitude)
        pressure = 0.5 * float(air(jnp.asarray(level.altitude))[0]) * level.airspeed**2
        bank_per_sideslip = -pressure * float(aircraft.wing_area) * SIDE_FORCE / (float(aircraft.mass) * GRAVITY)
        start = FlightState(level.airspeed, trim.alpha, trim.alpha, 0.0, level.altitude, trim=trim.command)
    stall = model.break_angle(values) + STALL_BEYOND
    rise = stall - trim.alpha if stall < DEFAULT_RANGES["alpha"][1] else STALL_RISE  # of the slow sweep, above trim
    return commands(time, trim, rise, bank_per_sideslip, amplitude, rigid), start


def fly_standard(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    level: steady.Condition,
    *,
    dt: float,
    amplitude: float = 1.0,
    envelope: Envelope = ANYWHERE,
) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, float], dict[str, str]]:
    """Fly all of `standard_pilots`: channels without noise, and `X`; recorded seconds; why others are refused."""
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    n, before = round(SECONDS / dt) + 1, round(RUN_IN / dt)
    time = (np.arange(n + before) - before) * dt
    for effect in model.acting if Axis.LATERAL in model.axes else ():
        steady.refuse_unsimulated(effect, steady.SIGNALS | {"aileron", "thrust_left", "thrust_right"})
    pilots, start = standard_pilots(model, values, aircraft, time, level, amplitude)
    flights = fly(model, values, aircraft, list(pilots.values()), [start] * len(pilots), dt)
    flown, refused = {}, {}
    for name, flight in zip(pilots, flights, strict=True):
        channels = {key: x[before:] for key, x in flight.items()}
        if left := envelope.left_by(excursion(channels)):
            refused[name] = f"it leaves its envelope: {left}"
        else:
            flown[name] = channels
    return flown, {name: until(pilots[name], time) for name in flown}, refused


def until(pilot: Pilot, time: Series) -> float:
    """Length of the record, s, after which a pilot gives no more input and the response has been recorded."""
    signals = [np.asarray(x) for x in pilot if np.ndim(x) == 1]
    moving = [np.flatnonzero(np.abs(np.diff(x)) > 1e-9 * np.max(np.abs(x) + 1e-30)) for x in signals]
    last = max((int(at[-1]) for at in moving if len(at)), default=0)
    return float(min(WHOLE * np.ceil((max(time[last], 0.0) + SETTLE) / WHOLE), SECONDS))


# --- Orthogonal multisines on several controls at once, with a small peak for their power.
# Source: Morelli, "Multiple input design for real-time parameter estimation in the frequency domain", IFAC SYSID
# 2003; first phases: Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85; their improvement: Van der Ouderaa, Schoukens
# and Renneboog, IEEE Trans. Instrum. Meas. 37 (1988) 145.

CLIP, ROUNDS = 0.9, 300  # of the peak that a round leaves, and rounds of clipping
GRID = 16  # points for each period of the highest frequency on which the peak is sought


def multisines(
    time: Float[np.ndarray, " n"], period: float, band: tuple[float, float], controls: int
) -> Float[np.ndarray, "c n"]:
    """Multisines (c, n) with a peak of 1, zero where `time` (s) is, that share no frequency; periodic in `period` (s).
    The multiples of 1/`period` in `band` (Hz) are dealt to the `controls` in turn, so that each covers the band. Over a
    whole period the inputs are uncorrelated, and so are their derivatives and integrals. Each needs two multiples."""
    k = np.arange(np.ceil(band[0] * period - 1e-9), np.floor(band[1] * period + 1e-9) + 1)
    signals = []
    for harmonics in (k[first::controls] for first in range(controls)):
        phase, at = _phases(harmonics), 2.0 * np.pi * time[:, None] / period
        fine = np.linspace(0.0, 2.0 * np.pi, GRID * int(harmonics[-1]) * 4)
        whole = np.sum(np.cos(fine[:, None] * harmonics + phase), axis=1)
        crossing = int(np.argmax(np.diff(np.sign(whole)) != 0.0))
        sum_at = lambda angle, k, phase: float(np.sum(np.cos(angle * k + phase)))  # noqa: E731
        zero: Any = brentq(sum_at, *fine[crossing : crossing + 2], args=(harmonics, phase))
        signals.append(np.sum(np.cos((at + zero) * harmonics + phase), axis=1) / np.max(np.abs(whole)))
    return np.stack(signals)


def _phases(k: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    order = np.arange(len(k))
    phase = -np.pi * order * (order + 1) / len(k)
    angle = np.linspace(0.0, 2.0 * np.pi, GRID * int(k[-1]), endpoint=False)
    basis = np.exp(1j * np.outer(k, angle))
    best, least = phase, np.inf
    for _ in range(ROUNDS):
        signal = np.real(np.exp(1j * phase) @ basis)
        peak = np.max(np.abs(signal))
        if peak < least:
            best, least = phase, peak
        phase = np.angle(basis.conj() @ np.clip(signal, -CLIP * peak, CLIP * peak))
    return best
