"""Controls that turn the aircraft the wrong way, and controls that only follow what the aircraft does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_banded
from scipy.optimize import fminbound

from bayes_aero.flight.card import Card
from bayes_aero.flight.health import CONTROLS, Findings, declared, found, noise_alone, noise_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import Axis

SMOOTH = 0.3  # s of the mean that keeps noise out of the angular acceleration
MOVED = np.deg2rad(0.1)  # rad that a surface must move, standard deviation of its fast part
SURE = 5.0  # standard errors, of the wrong sign
RESPONSE = 0.3  # 1/s2 a rad: no surface that flies an aircraft does less
SLOW = 3.0  # s: trim and speed change more slowly and are taken out
LIKELY = 3.0  # the same, of a response that is compared with what it would have made
FREE = 3.0  # independent samples that a fit needs beside one a regressor
LONGEST_REST = 5.0  # s; pilots hold a surface for 1 to 4 s
TWICE = 2.0  # times what the fit misses where the surface was recorded
UNSEEN = np.deg2rad(0.3)  # rad that must have moved, in the mean square
PAIR = ("aileron_right", "aileron_left")
TURNS = {
    "elevator": ("elevator", "elevator_left", "elevator_right", "elevon_left", "elevon_right", "stabilizer", "canard"),
    "aileron": ("aileron", *PAIR, "spoiler_left", "spoiler_right"),
    "rudder": ("rudder",),
}
"""Surfaces about an axis, the first first."""
ENGINES = ("thrust", "thrust_left", "thrust_right", "throttle", "n1_left", "n1_right", "flap")
UNMOVED, LARGE = 0.4, 0.015
"""Share of the angular acceleration (standard deviation) that motion does not explain where a surface moved, and its
least size, rad/s2. Our choice: with the elevator known, recorded and simulated flights of four aircraft leave less than
0.3 or less than 0.012 rad/s2."""
OUTPUTS = ("alpha", "beta", "p", "q", "r", "phi", "theta", "airspeed")
"""What control laws feed back. No accelerations: these are functions of the surface by the aircraft itself."""
OTHERS = (("beta", "p", "r", "phi", "airspeed"), ("alpha", "q", "theta", "airspeed"))
"""What a law of the elevator, and one of ailerons or rudder, do not integrate."""
ANGLE_OF = {"q": "theta", "p": "phi", "r": "psi"}
MAX_LAG, DELAYS = 0.5, (0.0, 0.1, 0.2)  # s, of an actuator or a filter between outputs and surface
LAG_ERROR = 1e-3  # s to which a lag is found
OWN, NOTHING = 0.05, 1e-3
"""Share of a surface's motion that must be its own where it is above noise, and at all. Our choice: on recorded
manoeuvres of three aircraft the surface that is flown has more than 0.02 of its own, 4 times its noise or more."""
AT_LIMITS = 0.1
"""Largest share of the fast motion at limits that a law with these limits may miss. Our choice: simulated laws miss
0.01, and with a pilot's steps a law misses 0.4 at least."""
ABOVE = 2.0  # times the noise of the smoothed signals, up to which what is left is noise
CANCELS = 4.0  # times the motion: outputs that each make more, against each other, are no law
STILL = 1e-9  # of a surface's range, below which differences are rounding of sums
PER_COLUMN = 5  # times `SMOOTH` of record that a regressor needs
EDGE, RATE, BETWEEN = 0.05, 0.05, 0.25
"""Share of a surface's range, next to its extremes, where it may be at a limit; s to both sides, for its rate; share of
its motion that it must make between the limits."""


class _Control(NamedTuple):
    """A surface, what else moves the rate that it turns, and the words for its positive direction and the answer."""

    surface: str
    beside: tuple[str, ...]
    rate: str
    answer: str
    rule: str
    otherwise: str  # what the file may count as positive instead


ELEVATOR = _Control(
    "elevator", ("alpha", "q"), "q", "the nose rises", "trailing edge down counts as positive and must lower it",
    "trailing edge up",
)  # fmt: skip
LATERAL = (
    _Control(
        "aileron", ("beta", "p", "r"), "p", "the aircraft rolls to the right",
        "half of right less left, trailing edges down, counts as positive and must roll it to the left", "the opposite",
    ),
    _Control(
        "rudder", ("beta", "r", "p"), "r", "the nose turns to the right",
        "trailing edge left counts as positive and must turn it to the left", "trailing edge right",
    ),
)  # fmt: skip


def control_responses(record: FlightRecord, card: Card) -> Findings:
    """Findings where an angular acceleration answers a positive deflection the wrong way."""
    for control in (ELEVATOR, *(LATERAL if Axis.LATERAL in card.axes else ())):
        fitted, surface = _fitted(control, record), control.surface
        if fitted is None or fitted.response < max(SURE * fitted.error, RESPONSE):
            continue
        if record.has(surface):
            sign = -declared(card, surface).sign
            mend = f"so if the file counts {control.otherwise} write sign = {sign} at {surface} on the card"
        else:
            mend = f"so {' and '.join(PAIR)} are swapped, or the file counts trailing edge up; correct them on the card"
        sentence = f"{surface}: {control.answer} with it ({fitted.response:+.2g} 1/s^2 a rad); {control.rule}, {mend}"
        yield found(record, surface, "sign", sentence, at=(0, record.n - 1))


def answers_unmoved(record: FlightRecord, name: str, run: tuple[int, int]) -> bool:
    """Whether the aircraft turns in a run of samples as if a surface moved that stands still there: the angular
    acceleration, fitted where the surface moves, must miss what only a deflection of `UNSEEN` makes, in flight that is
    less than the fitted range beyond it. An aileron or a rudder is not told where less than about 8 s are left in which
    it moves: gusts roll and yaw an aircraft, too."""
    control = next((c for c in (ELEVATOR, *LATERAL) if name in TURNS[c.surface]), None)
    if control is None or (run[1] - run[0]) * record.dt < LONGEST_REST:
        return False
    if control is ELEVATOR and (run[1] - run[0]) * record.dt >= 4.0 * SLOW:
        part = record.window(record.time[run[0]], record.time[run[1]])
        first = next((n for n in TURNS[ELEVATOR.surface] if part.has(n) and n not in _deflected(part)), None)
        if name == first and answers_no_input(part):
            return True
    fitted = _fitted(control, record, outside=(name, *run))
    if fitted is None:
        return False
    low, high = np.quantile(fitted.rows[fitted.used], [0.01, 0.99], axis=0)
    seen = np.all((fitted.rows >= 2.0 * low - high) & (fitted.rows <= 2.0 * high - low), axis=1)
    seen[: run[0]] = seen[run[1] + 1 :] = False
    if seen.sum() * record.dt < LONGEST_REST or not abs(fitted.response) > LIKELY * fitted.error:
        return False
    missed = float(np.sqrt(np.mean(fitted.left[seen] ** 2)))
    leverage = float(np.mean(np.sum(fitted.rows[seen] @ fitted.spread * fitted.rows[seen], axis=1)))
    return bool(missed > max(TWICE * fitted.usual * np.sqrt(1.0 + leverage), UNSEEN * abs(fitted.response)))


def answers_no_input(record: FlightRecord) -> bool:
    """Whether the aircraft pitches as neither motion nor a surface that moves explains. Each stretch is fitted by
    itself: a stall is not linear over the whole. Products of p and r turn the nose by inertia."""
    stretch = round(4.0 * SLOW / record.dt)
    if not all(map(record.has, ELEVATOR.beside)) or record.n < stretch:
        return False
    engines = (n for n in ENGINES if record.has(n) and not noise_alone(record[n]))
    moving = [record[n] for n in (*_deflected(record), *engines)]
    p, r = (record.channels.get(n, np.zeros(record.n)) for n in ("p", "r"))
    causes = (*(record[n] for n in ELEVATOR.beside), *moving, p * r, p**2 - r**2)
    rows = np.stack([*(_mean(x, SMOOTH / record.dt) for x in causes), np.ones(record.n), record.time], axis=1)
    turning = np.gradient(rows[:, ELEVATOR.beside.index(ELEVATOR.rate)], record.dt)
    noise = noise_of(record[ELEVATOR.rate]) / np.sqrt(SMOOTH / record.dt) / SMOOTH
    edge = round(SMOOTH / record.dt)
    for first in range(edge, max(record.n - edge - stretch, edge) + 1, round(SLOW / record.dt)):
        part = slice(first, min(first + stretch, record.n - edge))
        left = turning[part] - rows[part] @ np.linalg.lstsq(rows[part], turning[part], rcond=None)[0]
        if np.std(left) > max(UNMOVED * np.std(turning[part]), SURE * noise, LARGE):
            return True
    return False


class _Fit(NamedTuple):
    """Angular acceleration over a surface and the motion."""

    rows: np.ndarray  # regressors
    left: np.ndarray  # what they miss, rad/s2
    used: np.ndarray  # samples that it was fitted to
    response: float  # to the surface, 1/s2 a rad
    usual: float  # what is usually left
    spread: np.ndarray  # covariance of the fit over the square of that

    @property
    def error(self) -> float:
        """Standard error of the response."""
        return self.usual * float(np.sqrt(max(self.spread[0, 0], 0.0)))


def _deflected(record: FlightRecord) -> list[str]:
    """Surfaces that move by enough to turn the aircraft somewhere in the record."""
    there = [n for names in TURNS.values() for n in names if record.has(n)]
    size = {n: np.sqrt(_mean(_banded(record[n], record.dt) ** 2, 4.0 * SLOW / record.dt).max()) for n in there}
    return [n for n in there if size[n] > MOVED]


def _fitted(control: _Control, record: FlightRecord, outside: tuple[str, int, int] | None = None) -> _Fit | None:
    """The fit to all samples, or to those `outside` a run in which a surface about the axis stands still."""
    surface = control.surface if outside is None or outside[0] in PAIR else outside[0]
    deflection = _deflection(surface, record)
    if deflection is None or not all(map(record.has, control.beside)) or record.n * record.dt < 4.0 * SLOW:
        return None
    signals = [_banded(x, record.dt) for x in (deflection, *(record[name] for name in control.beside))]
    if signals[0].std() < MOVED:
        return None
    slope = np.gradient(signals[1 + control.beside.index(control.rate)], record.dt)
    used = np.ones(record.n, bool)
    if outside is not None:
        axes = ("elevator",) if control is ELEVATOR else ("aileron", "rudder")
        beside = {n for axis in axes for n in TURNS[axis]} - {surface, *(PAIR if surface == "aileron" else ())}
        signals += [_banded(record[n], record.dt) for n in _deflected(record) if n in beside]
        edge = round(0.5 * (SLOW + SMOOTH) / record.dt) + 1  # the means over these samples mix both
        used[max(outside[1] - edge, 0) : outside[2] + edge + 1] = False
    rows = np.stack([*signals, np.ones(record.n)], axis=1)
    independent = used.sum() * record.dt / (3.0 * SMOOTH) - rows.shape[1]
    if outside is not None and independent < FREE:
        return None
    # Samples of smoothed signals repeat each other: one in a smoothing length counts.
    fit, *_ = np.linalg.lstsq(rows[used], slope[used], rcond=None)
    left = slope - rows @ fit
    free = max(independent, 1.0) / (independent + rows.shape[1])
    spread = np.linalg.pinv(rows[used].T @ rows[used]) * used.sum() / (independent + rows.shape[1])
    return _Fit(rows, left, used, float(fit[0]), float(np.sqrt(np.mean(left[used] ** 2) / free)), spread)


def feedback(records: Sequence[FlightRecord], card: Card) -> Findings:
    """Findings for surfaces that follow the outputs, to within noise, in every record where they move: the law of
    the feedback fits as well as the aircraft does. A pilot's input beside it separates the two. Source: L. Ljung,
    System Identification, 2nd ed. 1999, sec. 13.4; Jategaonkar 2015, ch. 9 (unstable aircraft)."""
    if card.linear is not None:
        surfaces = [name for name in card.linear.inputs if name in CONTROLS]
    else:
        controls = ((Axis.LONGITUDINAL, ELEVATOR), *((Axis.LATERAL, control) for control in LATERAL))
        surfaces = [control.surface for axis, control in controls if axis in card.axes]
    for surface in surfaces:
        flown = [r for r in records if (u := _deflection(surface, r)) is not None and np.ptp(u) > 0.0]
        moved = [(record, law) for record in flown if (law := law_of(surface, record, card)) is not None]
        # A record that cannot be judged may hold the pilot's input.
        if not moved or len(moved) < len(flown) or not all(names for _, (names, _) in moved):
            continue
        for record, (names, left) in moved:
            sentence = (
                f"{surface} follows the recorded {', '.join(names)}: all but {left}, which is within noise. The "
                "feedback and the aircraft cannot be parted, and no derivative of this axis is usable. Fly an input of "
                f"the pilot (a doublet, a multisine) to the {surface} beside the feedback, join a record that has one, "
                "or fix the derivatives on the card that are known"
            )
            yield found(record, surface, "feedback", sentence, at=(0, record.n - 1))


def law_of(surface: str, record: FlightRecord, card: Card) -> tuple[list[str], str] | None:
    """The outputs that a surface follows (none where it has its own motion) and how much of its motion is left; None
    where it drifts or decays at most, or the record is too short. Integrals and limits are tried where they must be."""
    u = _deflection(surface, record)
    recorded = [n for n in dict.fromkeys((*OUTPUTS, *(card.linear.states if card.linear else ()))) if record.has(n)]
    moved = [n for n in recorded if np.ptp(record[n]) > 0.0 and not noise_alone(record[n])]
    outputs = {n: (record[n] - record[n].mean()) / np.std(record[n]) for n in moved}
    if u is None or not outputs or np.ptp(u) == 0.0 or noise_alone(u):
        return None
    # The integral of a rate is the angle: both of them would be fitted with large weights against each other.
    unsummed = OTHERS[surface not in TURNS[ELEVATOR.surface]]
    summed = {n: x for n, x in outputs.items() if ANGLE_OF.get(n) not in outputs and n not in unsummed}
    sums = [(n, record.dt * np.cumsum(x)) for n, x in summed.items()]
    laws = [[*outputs.items()], [*outputs.items(), *sums]]
    # Of an angle that is not recorded, the integral is the second one of its rate, whose bias makes a parabola.
    parabola = np.vander(np.linspace(-1.0, 1.0, record.n), 3)
    twice = [(n, record.dt * np.cumsum(x)) for n, x in sums if ANGLE_OF.get(n) in OUTPUTS]
    twice = [(n, x - parabola @ np.linalg.lstsq(parabola, x, rcond=None)[0]) for n, x in twice]
    laws += [[*laws[1], *twice, ("", parabola[:, 0])]] if twice else []
    inside = _inside(u, record.dt)
    moving = _mean(u, SMOOTH / record.dt)[inside]
    if not len(moving) or np.ptp(moving) <= STILL * np.ptp(u):
        return None  # too short, or it moves at an end of the record alone
    judged = False
    for limits in (None, _Limits.of(u, record.dt)):
        free = np.ones(record.n, bool) if limits is None else limits.free
        room = free.sum() * record.dt / SMOOTH / PER_COLUMN - 2.0
        if len(outputs) > room or np.std(moving[free[inside]]) < BETWEEN * np.std(moving):
            break
        in_time = _followed(u, np.zeros((0, record.n)), record.dt, SLOW, limits)
        if in_time.share < NOTHING or in_time.within:
            break
        for columns in laws:
            if len(columns) > room:
                break
            law = _followed(u, np.array([x for _, x in columns]), record.dt, MAX_LAG, limits)
            judged = True
            made = [(n, size) for (n, _), size in zip(columns, law.made, strict=True) if n]
            largest = max(size for _, size in made)
            follows = law.share < NOTHING or (law.share < OWN and law.within)
            if follows and law.at_limits < AT_LIMITS and largest < CANCELS:
                names = dict.fromkeys(n for n, size in made if size > 0.1 * largest)
                between = "" if limits is None else " between its limits"
                return [*names], f"{law.share:.1%} of its motion{between}"
    return ([], "") if judged else None


class _Limits(NamedTuple):
    """Least and largest deflection, rad, largest rate, rad/s, and the samples that are well within them."""

    low: float
    high: float
    rate: float
    free: np.ndarray

    @classmethod
    def of(cls, u: Float[np.ndarray, " n"], dt: float) -> _Limits:
        """The limits that a surface has if its extremes are limits."""
        half = max(1, round(RATE / dt))
        padded = np.pad(u, half, mode="edge")
        rate = (padded[2 * half :] - padded[: -2 * half]) / (2 * half * dt)
        (low, high), fast = np.quantile(u, [0.01, 0.99]), float(np.quantile(np.abs(rate), 0.98))
        edge = EDGE * (high - low)
        within = (u > low + edge) & (u < high - edge) & (np.abs(rate) < (1.0 - 2.0 * EDGE) * fast)
        return cls(float(low), float(high), fast, _mean(within.astype(float), SMOOTH / dt) > 1.0 - 1e-9)


class _Followed(NamedTuple):
    """A law of a surface."""

    made: np.ndarray  # the motion that each regressor makes over the surface's, standard deviations
    share: float  # of the surface's motion (a variance) that the law misses between limits
    within: bool  # whether that is no more than noise
    at_limits: float  # share of the fast motion at limits that the law with these limits misses


def _followed(
    u: Float[np.ndarray, " n"], columns: Float[np.ndarray, "k n"], dt: float, longest: float, limits: _Limits | None
) -> _Followed:
    """The best law of outputs behind a lag of at most `longest` s and a delay, fitted to the samples within limits."""
    window = SMOOTH / dt
    # Noise of a regressor makes its weight too small: the law is fitted to what is smoothed.
    inside = _inside(u, dt)
    rows = np.concatenate([columns, [np.linspace(0.0, 1.0, len(u))], np.ones((1, len(u)))])
    slow, target = np.array([_mean(x, window)[inside] for x in rows]), _mean(u, window)[inside]
    free = np.ones(len(target), bool) if limits is None else limits.free[inside]

    def law(lag: float, delay: int) -> tuple[np.ndarray, np.ndarray]:
        late, own = _late(slow[:, : slow.shape[1] - delay], target[delay:], free[delay:], lag, dt)
        late, own = late[:, free[delay:]], (target[delay:] - own)[free[delay:]]
        weights = np.linalg.lstsq(late @ late.T, late @ own, rcond=None)[0]
        return weights, own - weights @ late

    tried = []
    for delay in (round(d / dt) for d in DELAYS):
        best = np.asarray(fminbound(lambda lag, d=delay: float(np.var(law(lag, d)[1])), 0.0, longest, xtol=LAG_ERROR))
        tried += [(float(np.var(law(lag, delay)[1])), lag, delay) for lag in (0.0, float(best.flat[0]))]
    _, lag, delay = min(tried)
    weights, left = law(lag, delay)
    # A lag takes noise of the outputs out of fast differences, not out of what is left: it is counted before the lag.
    made = np.abs(weights[: len(columns)])
    noise = float(np.hypot(noise_of(u), np.linalg.norm(made * [noise_of(x) for x in columns])))
    moved, own = float(np.std(target[free])), float(np.std(left))
    at_limits = 0.0
    if limits is not None and not free.all():
        asked = np.concatenate([np.full(delay, u[0]), (weights @ rows)[: len(u) - delay]])
        # from the surface's first position, it follows what is asked for behind the lag, within the limits
        share, step, followed = 1.0 if lag <= 1e-3 * dt else 1.0 - np.exp(-dt / lag), limits.rate * dt, [u[0]]
        for goal in asked:
            to = followed[-1] + min(max((goal - followed[-1]) * share, -step), step)
            followed.append(min(max(to, limits.low), limits.high))
        whole = _mean(np.array(followed[1:]), window)[inside]
        fast = [(x - _mean(x, SLOW / dt))[~free] for x in (target, target - whole)]
        at_limits = float(np.mean(fast[1] ** 2) / np.mean(fast[0] ** 2))
    made = made * columns.std(axis=1) / float(np.std(target))
    return _Followed(made, (own / moved) ** 2, bool(own < ABOVE * noise / np.sqrt(window)), at_limits)


def _inside(u: np.ndarray, dt: float) -> slice:
    """Samples whose mean over `SMOOTH` does not reach beyond the ends of the record."""
    edge = round(SMOOTH / dt)
    return slice(edge, len(u) - edge)


def _late(
    x: Float[np.ndarray, "k n"], u: Float[np.ndarray, " n"], free: np.ndarray, lag: float, dt: float
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, " n"]]:
    """Signals behind a lag of first order, and what the surface's own position adds, where it begins and at limits."""
    pole = np.exp(-dt / lag) if lag > 1e-3 * dt else 0.0
    held = ~free | (np.arange(len(u)) == 0)
    # y - pole y(one earlier) = (1 - pole) x as a banded system: `scipy.signal` is slow to load, and `check` needs this.
    bands = np.array([np.ones(len(u)), np.append(np.where(held[1:], 0.0, -pole), 0.0)])
    driven = np.concatenate([np.where(held, 0.0, (1.0 - pole) * x), [np.where(held, u, 0.0)]])
    *late, own = solve_banded((1, 0), bands, driven.T, check_finite=False).T
    return np.array(late), own


def _deflection(surface: str, record: FlightRecord) -> Float[np.ndarray, " n"] | None:
    """The surface as recorded; ailerons also from their pair."""
    if record.has(surface):
        return record[surface]
    if surface == "aileron" and all(map(record.has, PAIR)):
        return 0.5 * (record[PAIR[0]] - record[PAIR[1]])
    return None


def _banded(x: np.ndarray, dt: float) -> np.ndarray:
    """Smoothed, and without what is slower than a few seconds."""
    return _mean(x, SMOOTH / dt) - _mean(x, SLOW / dt)


def _mean(x: np.ndarray, samples: float) -> np.ndarray:
    half = min(max(1, round(samples / 2.0)), (len(x) - 1) // 2)
    return np.convolve(np.pad(x, half, mode="edge"), np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
