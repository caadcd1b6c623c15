"""Controls that turn the aircraft the wrong way, and controls that only follow what the aircraft does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_banded
from scipy.optimize import fminbound

from bayes_aero.flight.card import Card
from bayes_aero.flight.health import CONTROLS, Findings, declared, finding, noise_alone, noise_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import Axis

SMOOTH = 0.3  # s of the mean that keeps noise out of the angular acceleration
SLOW = 3.0  # s: trim and speed change more slowly and are taken out
WHOLE = 4.0 * SLOW  # s that a fit takes
MOVED = np.deg2rad(0.1)  # rad that a surface must move, standard deviation of its fast part
SURE = 5.0  # standard errors, of the wrong sign
LONGEST_REST = 5.0  # s; pilots hold a surface for 1 to 4 s
PAIR = ("aileron_right", "aileron_left")
TURNS = {
    "elevator": ("elevator", "elevator_left", "elevator_right", "elevon_left", "elevon_right", "stabilizer", "canard"),
    "aileron": ("aileron", *PAIR, "spoiler_left", "spoiler_right"),
    "rudder": ("rudder",),
}
"""Surfaces about an axis, the first first."""
ENGINES = ("thrust", "thrust_left", "thrust_right", "throttle", "n1_left", "n1_right", "flap")
OUTPUTS = ("alpha", "beta", "p", "q", "r", "phi", "theta", "airspeed")
"""What control laws feed back. No accelerations: these are functions of the surface by the aircraft itself."""
OTHERS = (("beta", "p", "r", "phi", "airspeed"), ("alpha", "q", "theta", "airspeed"))
"""What a law of the elevator, and one of ailerons or rudder, do not integrate."""
ANGLE_OF = {"q": "theta", "p": "phi", "r": "psi"}


class _Control(NamedTuple):
    """A surface, what else moves the rate that it turns, and the words for its positive direction and the answer."""

    surface: str
    beside: tuple[str, ...]  # the rate that it turns first
    answer: str
    rule: str
    otherwise: str  # what the file may count as positive instead


ELEVATOR = _Control(
    "elevator", ("q", "alpha"), "the nose rises", "trailing edge down counts as positive and must lower it",
    "trailing edge up",
)  # fmt: skip
LATERAL = (
    _Control(
        "aileron", ("p", "beta", "r"), "the aircraft rolls to the right",
        "half of right less left, trailing edges down, counts as positive and must roll it to the left", "the opposite",
    ),
    _Control(
        "rudder", ("r", "beta", "p"), "the nose turns to the right",
        "trailing edge left counts as positive and must turn it to the left", "trailing edge right",
    ),
)  # fmt: skip


def control_responses(record: FlightRecord, card: Card) -> Findings:
    """Findings where an angular acceleration answers a positive deflection the wrong way."""
    for control in (ELEVATOR, *(LATERAL if Axis.LATERAL in card.axes else ())):
        fit, surface = _fitted(control, record), control.surface
        if fit is None or fit.response < max(SURE * fit.error, 0.3):  # no surface that flies an aircraft does less
            continue
        mend = f"so {' and '.join(PAIR)} are swapped, or the file counts trailing edge up; correct them on the card"
        if record.has(surface):
            sign = -declared(card, surface).sign
            mend = f"so if the file counts {control.otherwise} write sign = {sign} at {surface} on the card"
        sentence = f"{surface}: {control.answer} with it ({fit.response:+.2g} 1/s^2 a rad); {control.rule}, {mend}"
        yield finding(record, surface, "sign", sentence)


def answers_unmoved(record: FlightRecord, name: str, run: tuple[int, int]) -> bool:
    """Whether the aircraft turns in a run of samples as if a surface moved that stands still there: the angular
    acceleration, fitted where the surface moves, must miss what only a deflection of 0.3 deg makes, in flight that is
    less than the fitted range beyond it. An aileron or a rudder is not told where less than about 8 s are left in which
    it moves: gusts roll and yaw an aircraft, too."""
    control = next((c for c in (ELEVATOR, *LATERAL) if name in TURNS[c.surface]), None)
    seconds = (run[1] - run[0]) * record.dt
    if control is None or seconds < LONGEST_REST:
        return False
    if control is ELEVATOR and seconds >= WHOLE:
        part = record.window(record.time[run[0]], record.time[run[1]])
        first = next((n for n in TURNS[ELEVATOR.surface] if part.has(n) and n not in _deflected(part)), None)
        if name == first and answers_no_input(part):
            return True
    if (fit := _fitted(control, record, (name, *run))) is None:
        return False
    low, high = np.quantile(fit.rows[fit.used], [0.01, 0.99], axis=0)
    seen = np.all((fit.rows >= 2.0 * low - high) & (fit.rows <= 2.0 * high - low), axis=1)
    seen[: run[0]] = seen[run[1] + 1 :] = False
    if seen.sum() * record.dt < LONGEST_REST or not abs(fit.response) > 3.0 * fit.error:
        return False
    missed = float(np.sqrt(np.mean(fit.left[seen] ** 2)))
    leverage = float(np.mean(np.sum(fit.rows[seen] @ fit.spread * fit.rows[seen], axis=1)))
    return bool(missed > max(2.0 * fit.usual * np.sqrt(1.0 + leverage), np.deg2rad(0.3) * abs(fit.response)))


def answers_no_input(record: FlightRecord) -> bool:
    """Whether the aircraft pitches as neither motion nor a surface that moves explains. Each stretch is fitted by
    itself: a stall is not linear over the whole. Products of p and r turn the nose by inertia. Our choice: with the
    elevator known, flights of four aircraft leave less than 0.3 of the acceleration or less than 0.012 rad/s2."""
    stretch, edge = round(WHOLE / record.dt), round(SMOOTH / record.dt)
    if not all(map(record.has, ELEVATOR.beside)) or record.n < stretch:
        return False
    engines = (n for n in ENGINES if record.has(n) and not noise_alone(record[n]))
    p, r = (record.channels.get(n, np.zeros(record.n)) for n in ("p", "r"))
    causes = (*(record[n] for n in (*ELEVATOR.beside, *_deflected(record), *engines)), p * r, p**2 - r**2)
    rows = np.stack([*(_mean(x, SMOOTH / record.dt) for x in causes), np.ones(record.n), record.time], axis=1)
    turning = np.gradient(rows[:, 0], record.dt)
    noise = noise_of(record["q"]) / np.sqrt(SMOOTH / record.dt) / SMOOTH
    for first in range(edge, max(record.n - edge - stretch, edge) + 1, round(SLOW / record.dt)):
        part = slice(first, min(first + stretch, record.n - edge))
        left = turning[part] - rows[part] @ np.linalg.lstsq(rows[part], turning[part], rcond=None)[0]
        if np.std(left) > max(0.4 * np.std(turning[part]), SURE * noise, 0.015):
            return True
    return False


class _Fit(NamedTuple):
    """Angular acceleration over a surface and the motion."""

    rows: np.ndarray  # regressors
    left: np.ndarray  # what they miss, rad/s2
    used: np.ndarray  # samples that it was fitted to
    response: float  # to the surface, 1/s2 a rad
    error: float  # standard error of that
    usual: float  # what is usually left
    spread: np.ndarray  # covariance of the fit over the square of that


def _fitted(control: _Control, record: FlightRecord, outside: tuple[str, int, int] | None = None) -> _Fit | None:
    """The fit to all samples, or to those `outside` a run in which a surface about the axis stands still."""
    surface = control.surface if outside is None or outside[0] in PAIR else outside[0]
    deflection = _deflection(surface, record)
    if deflection is None or not all(map(record.has, control.beside)) or record.n * record.dt < WHOLE:
        return None
    signals = [_banded(x, record.dt) for x in (deflection, *(record[name] for name in control.beside))]
    if signals[0].std() < MOVED:
        return None
    slope, used = np.gradient(signals[1], record.dt), np.ones(record.n, bool)
    if outside is not None:
        axes = ("elevator",) if control is ELEVATOR else ("aileron", "rudder")
        beside = {n for axis in axes for n in TURNS[axis]} - {surface, *(PAIR if surface == "aileron" else ())}
        signals += [_banded(record[n], record.dt) for n in _deflected(record) if n in beside]
        edge = round(0.5 * (SLOW + SMOOTH) / record.dt) + 1  # the means over these samples mix both
        used[max(outside[1] - edge, 0) : outside[2] + edge + 1] = False
    rows = np.stack([*signals, np.ones(record.n)], axis=1)
    # Samples of smoothed signals repeat each other: one in a smoothing length counts.
    independent = used.sum() * record.dt / (3.0 * SMOOTH) - rows.shape[1]
    if outside is not None and independent < 3.0:
        return None
    fit, *_ = np.linalg.lstsq(rows[used], slope[used], rcond=None)
    left = slope - rows @ fit
    counted = independent + rows.shape[1]
    usual = float(np.sqrt(np.mean(left[used] ** 2) * counted / max(independent, 1.0)))
    spread = np.linalg.pinv(rows[used].T @ rows[used]) * used.sum() / counted
    return _Fit(rows, left, used, float(fit[0]), usual * float(np.sqrt(max(spread[0, 0], 0.0))), usual, spread)


def _deflected(record: FlightRecord) -> list[str]:
    """Surfaces that move by enough to turn the aircraft somewhere in the record."""
    there = [n for names in TURNS.values() for n in names if record.has(n)]
    size = {n: np.sqrt(_mean(_banded(record[n], record.dt) ** 2, WHOLE / record.dt).max()) for n in there}
    return [n for n in there if size[n] > MOVED]


# --- Feedback. Shares are our choice: on recorded manoeuvres of three aircraft the surface that is flown has more than
# 0.02 of its own motion, 4 times its noise or more; simulated laws miss 0.01 of the fast motion at limits, and with a
# pilot's steps a law misses 0.4 at least.

OWN, NOTHING = 0.05, 1e-3  # share of a surface's motion that must be its own where it is above noise, and at all
AT_LIMITS = 0.1  # largest share of the fast motion at limits that a law with these limits may miss
CANCELS = 4.0  # times the motion: outputs that each make more, against each other, are no law
EDGE = 0.05  # share of a surface's range, next to its extremes, where it may be at a limit


def feedback(records: Sequence[FlightRecord], card: Card) -> Findings:
    """Findings for surfaces that follow the outputs, to within noise, in every record where they move: the law of
    the feedback fits as well as the aircraft does. A pilot's input beside it separates the two. Source: L. Ljung,
    System Identification, 2nd ed. 1999, sec. 13.4; Jategaonkar 2015, ch. 9 (unstable aircraft)."""
    controls = ((Axis.LONGITUDINAL, ELEVATOR), *((Axis.LATERAL, control) for control in LATERAL))
    surfaces = [control.surface for axis, control in controls if axis in card.axes]
    if card.linear is not None:
        surfaces = [name for name in card.linear.inputs if name in CONTROLS]
    for surface in surfaces:
        flown = [r for r in records if (u := _deflection(surface, r)) is not None and np.ptp(u) > 0.0]
        moved = [(record, law) for record in flown if (law := law_of(surface, record, card)) is not None]
        # A record that cannot be judged may hold the pilot's input.
        if len(moved) < len(flown) or not all(names for _, (names, _) in moved):
            continue
        for record, (names, left) in moved:
            yield finding(
                record, surface, "feedback",
                f"{surface} follows the recorded {', '.join(names)}: all but {left}, which is within noise. The "
                "feedback and the aircraft cannot be parted, and no derivative of this axis is usable. Fly an input of "
                f"the pilot (a doublet, a multisine) to the {surface} beside the feedback, join a record that has one, "
                "or fix the derivatives on the card that are known",
            )  # fmt: skip


def law_of(surface: str, record: FlightRecord, card: Card) -> tuple[list[str], str] | None:
    """The outputs that a surface follows (none where it has its own motion) and how much of its motion is left; None
    where it drifts or decays at most, or the record is too short. Integrals and limits are tried where they must be."""
    u, dt = _deflection(surface, record), record.dt
    recorded = [n for n in dict.fromkeys((*OUTPUTS, *(card.linear.states if card.linear else ()))) if record.has(n)]
    moved = [n for n in recorded if np.ptp(record[n]) > 0.0 and not noise_alone(record[n])]
    outputs = {n: (record[n] - record[n].mean()) / np.std(record[n]) for n in moved}
    if u is None or not outputs or np.ptp(u) == 0.0 or noise_alone(u):
        return None
    # The integral of a rate is the angle: both of them would be fitted with large weights against each other.
    unsummed = OTHERS[surface not in TURNS["elevator"]]
    sums = [(n, dt * np.cumsum(x)) for n, x in outputs.items() if ANGLE_OF.get(n) not in outputs and n not in unsummed]
    laws = [[*outputs.items()], [*outputs.items(), *sums]]
    # Of an angle that is not recorded, the integral is the second one of its rate, whose bias makes a parabola.
    parabola = np.vander(np.linspace(-1.0, 1.0, record.n), 3)
    twice = [(n, dt * np.cumsum(x)) for n, x in sums if ANGLE_OF.get(n) in OUTPUTS]
    twice = [(n, x - parabola @ np.linalg.lstsq(parabola, x, rcond=None)[0]) for n, x in twice]
    laws += [[*laws[1], *twice, ("", parabola[:, 0])]] if twice else []
    moving = _mean(u, SMOOTH / dt)[_inside(u, dt)]
    if not len(moving) or np.ptp(moving) <= 1e-9 * np.ptp(u):
        return None  # too short, or it moves at an end of the record alone
    judged = False
    for limits in (None, _limits(u, dt)):
        free = np.ones(record.n, bool) if limits is None else limits[3]
        room = free.sum() * dt / SMOOTH / 5.0 - 2.0  # columns, of which each needs five smoothing lengths
        if len(outputs) > room or np.std(moving[free[_inside(u, dt)]]) < 0.25 * np.std(moving):
            break
        _, share, within, _ = _followed(u, np.zeros((0, record.n)), dt, SLOW, limits)
        if share < NOTHING or within:  # time alone explains it
            break
        for columns in laws:
            if len(columns) > room:
                break
            made, share, within, missed = _followed(u, np.array([x for _, x in columns]), dt, 0.5, limits)
            judged = True
            sizes = [(n, size) for (n, _), size in zip(columns, made, strict=True) if n]
            most = max(size for _, size in sizes)
            if (share < NOTHING or (share < OWN and within)) and missed < AT_LIMITS and most < CANCELS:
                names = dict.fromkeys(n for n, size in sizes if size > 0.1 * most)
                return [*names], f"{share:.1%} of its motion{'' if limits is None else ' between its limits'}"
    return ([], "") if judged else None


_Limits = tuple[float, float, float, np.ndarray]
"""Least and largest deflection, rad, largest rate, rad/s, and the samples that are well within them."""


def _limits(u: Float[np.ndarray, " n"], dt: float) -> _Limits:
    """The limits that a surface has if its extremes are limits."""
    half = max(1, round(0.05 / dt))
    padded = np.pad(u, half, mode="edge")
    rate = (padded[2 * half :] - padded[: -2 * half]) / (2 * half * dt)
    (low, high), fast = np.quantile(u, [0.01, 0.99]), float(np.quantile(np.abs(rate), 0.98))
    edge = EDGE * (high - low)
    within = (u > low + edge) & (u < high - edge) & (np.abs(rate) < (1.0 - 2.0 * EDGE) * fast)
    return float(low), float(high), fast, _mean(within.astype(float), SMOOTH / dt) > 1.0 - 1e-9


def _followed(
    u: Float[np.ndarray, " n"], columns: Float[np.ndarray, "k n"], dt: float, most: float, limits: _Limits | None
) -> tuple[np.ndarray, float, bool, float]:
    """The best law of outputs behind a lag of at most `most` s and a delay, fitted to the samples within limits: the
    motion that each regressor makes over the surface's (standard deviations), the share of the surface's motion (a
    variance) that is left and whether that is no more than noise, and the share of the fast motion at limits that a law
    with these limits misses."""
    window, inside = SMOOTH / dt, _inside(u, dt)
    # Noise of a regressor makes its weight too small: the law is fitted to what is smoothed.
    rows = np.concatenate([columns, [np.linspace(0.0, 1.0, len(u))], np.ones((1, len(u)))])
    slow, target = np.array([_mean(x, window)[inside] for x in rows]), _mean(u, window)[inside]
    free = np.ones(len(target), bool) if limits is None else limits[3][inside]

    def law(lag: float, delay: int) -> tuple[np.ndarray, np.ndarray]:
        late, own = _late(slow[:, : slow.shape[1] - delay], target[delay:], free[delay:], lag, dt)
        late, own = late[:, free[delay:]], (target[delay:] - own)[free[delay:]]
        weights = np.linalg.lstsq(late @ late.T, late @ own, rcond=None)[0]
        return weights, own - weights @ late

    tried = []
    for delay in (round(d / dt) for d in (0.0, 0.1, 0.2)):
        best = fminbound(lambda lag, d=delay: float(np.var(law(lag, d)[1])), 0.0, most, xtol=1e-3)
        tried += [(float(np.var(law(lag, delay)[1])), lag, delay) for lag in (0.0, float(np.ravel(best)[0]))]
    _, lag, delay = min(tried)
    weights, left = law(lag, delay)
    # A lag takes noise of the outputs out of fast differences, not out of what is left: it is counted before the lag.
    made = np.abs(weights[: len(columns)])
    noise = float(np.hypot(noise_of(u), np.linalg.norm(made * [noise_of(x) for x in columns])))
    missed = 0.0
    if limits is not None and not free.all():
        asked = np.concatenate([np.full(delay, u[0]), (weights @ rows)[: len(u) - delay]])
        # from the surface's first position, it follows what is asked for behind the lag, within the limits
        share, step, at = 1.0 if lag <= 1e-3 * dt else 1.0 - np.exp(-dt / lag), limits[2] * dt, [u[0]]
        for goal in asked:
            to = at[-1] + min(max((goal - at[-1]) * share, -step), step)
            at.append(min(max(to, limits[0]), limits[1]))
        whole = _mean(np.array(at[1:]), window)[inside]
        fast = [(x - _mean(x, SLOW / dt))[~free] for x in (target, target - whole)]
        missed = float(np.mean(fast[1] ** 2) / np.mean(fast[0] ** 2))
    own = float(np.std(left))
    within = bool(own < 2.0 * noise / np.sqrt(window))
    made = made * columns.std(axis=1) / float(np.std(target))
    return made, (own / float(np.std(target[free]))) ** 2, within, missed


def _inside(u: np.ndarray, dt: float) -> slice:
    """Samples whose mean over `SMOOTH` does not reach beyond the ends of the record."""
    edge = round(SMOOTH / dt)
    return slice(edge, len(u) - edge)


def _late(
    x: Float[np.ndarray, "k n"], u: Float[np.ndarray, " n"], free: np.ndarray, lag: float, dt: float
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, " n"]]:
    """Signals behind a lag of first order, and what the surface's own position adds, where it begins and at limits."""
    pole, held = np.exp(-dt / lag) if lag > 1e-3 * dt else 0.0, ~free | (np.arange(len(u)) == 0)
    # y - pole y(one earlier) = (1 - pole) x as a banded system: `scipy.signal` is slow to load, and `check` needs this.
    bands = np.array([np.ones(len(u)), np.append(np.where(held[1:], 0.0, -pole), 0.0)])
    driven = np.concatenate([np.where(held, 0.0, (1.0 - pole) * x), [np.where(held, u, 0.0)]])
    *late, own = solve_banded((1, 0), bands, driven.T, check_finite=False).T
    return np.array(late), own


def _deflection(surface: str, record: FlightRecord) -> Float[np.ndarray, " n"] | None:
    """The surface as recorded; ailerons also from their pair."""
    if surface == "aileron" and not record.has(surface) and all(map(record.has, PAIR)):
        return 0.5 * (record[PAIR[0]] - record[PAIR[1]])
    return record.channels.get(surface)


def _banded(x: np.ndarray, dt: float) -> np.ndarray:
    """Smoothed, and without what is slower than a few seconds."""
    return _mean(x, SMOOTH / dt) - _mean(x, SLOW / dt)


def _mean(x: np.ndarray, samples: float) -> np.ndarray:
    half = min(max(1, round(samples / 2.0)), (len(x) - 1) // 2)
    return np.convolve(np.pad(x, half, mode="edge"), np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
