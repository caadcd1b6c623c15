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
    """Findings where an angular acceleration, fitted over the surface and the motion, answers a positive deflection the
    wrong way."""
    for control in (ELEVATOR, *(LATERAL if Axis.LATERAL in card.axes else ())):
        surface, deflection = control.surface, _deflection(control.surface, record)
        if deflection is None or not all(map(record.has, control.beside)) or record.n * record.dt < WHOLE:
            continue
        signals = [_banded(x, record.dt) for x in (deflection, *(record[name] for name in control.beside))]
        rows, slope = np.stack([*signals, np.ones(record.n)], axis=1), np.gradient(signals[1], record.dt)
        # Samples of smoothed signals repeat each other: one in a smoothing length counts.
        counted = record.n * record.dt / (3.0 * SMOOTH)
        fit, *_ = np.linalg.lstsq(rows, slope, rcond=None)
        usual = np.mean((slope - rows @ fit) ** 2) * record.n / max(counted - rows.shape[1], 1.0)
        error = float(np.sqrt(usual * max(np.linalg.pinv(rows.T @ rows)[0, 0], 0.0)))
        if signals[0].std() < MOVED or fit[0] < max(SURE * error, 0.3):  # no surface that flies an aircraft does less
            continue
        mend = f"so {' and '.join(PAIR)} are swapped, or the file counts trailing edge up; correct them on the card"
        if record.has(surface):
            sign = -declared(card, surface).sign
            mend = f"so if the file counts {control.otherwise} write sign = {sign} at {surface} on the card"
        claim = f"{surface}: {control.answer} with it"
        yield finding(record, surface, "sign", (claim, f" ({fit[0]:+.2g} 1/s^2 a rad); {control.rule}", mend))


def answers_unmoved(record: FlightRecord, name: str, run: tuple[int, int]) -> bool:
    """Whether the aircraft pitches in a run of samples as if the first elevator that stands still there had moved."""
    if name not in TURNS["elevator"] or (run[1] - run[0]) * record.dt < WHOLE:
        return False
    part = record.window(record.time[run[0]], record.time[run[1]])
    still = (n for n in TURNS["elevator"] if part.has(n) and n not in _deflected(part))
    return name == next(still, None) and answers_no_input(part)


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


def _deflected(record: FlightRecord) -> list[str]:
    """Surfaces that move by enough to turn the aircraft somewhere in the record."""
    there = [n for names in TURNS.values() for n in names if record.has(n)]
    size = {n: np.sqrt(_mean(_banded(record[n], record.dt) ** 2, WHOLE / record.dt).max()) for n in there}
    return [n for n in there if size[n] > MOVED]


# --- Feedback.

OWN, NOTHING = 0.05, 1e-3
"""Share of a surface's motion that must be its own where it is above noise, and at all. Our choice: on recorded
manoeuvres of three aircraft the surface that is flown has more than 0.02 of its own, 4 times its noise or more."""
CANCELS = 4.0  # times the motion: outputs that each make more, against each other, are no law


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
                (f"{surface} follows the recorded {', '.join(names)}",
                f": all but {left}, which is within noise. The feedback and the aircraft cannot be parted, and no "
                "derivative of this axis is usable",
                f"fly a pilot's input to the {surface} beside the feedback, join a record that has one, or fix the "
                "known derivatives on the card"),
            )  # fmt: skip


def law_of(surface: str, record: FlightRecord, card: Card) -> tuple[list[str], str] | None:
    """The outputs that a surface follows (none where it has its own motion) and how much of its motion is left; None
    where it drifts or decays at most, or the record is too short. Integrals are tried where they must be."""
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
    room = record.n * dt / SMOOTH / 5.0 - 2.0  # columns, of which each needs five smoothing lengths
    _, share, within = _followed(u, np.zeros((0, record.n)), dt, SLOW)
    if len(outputs) > room or share < NOTHING or within:  # time alone explains it
        return None
    for columns in laws:
        if len(columns) > room:
            break
        made, share, within = _followed(u, np.array([x for _, x in columns]), dt, 0.5)
        sizes = [(n, size) for (n, _), size in zip(columns, made, strict=True) if n]
        most = max(size for _, size in sizes)
        if (share < NOTHING or (share < OWN and within)) and most < CANCELS:
            names = dict.fromkeys(n for n, size in sizes if size > 0.1 * most)
            return [*names], f"{share:.1%} of its motion"
    return [], ""


def _followed(
    u: Float[np.ndarray, " n"], columns: Float[np.ndarray, "k n"], dt: float, most: float
) -> tuple[np.ndarray, float, bool]:
    """The best law of outputs behind a lag of at most `most` s and a delay: the motion that each regressor makes over
    the surface's (standard deviations), the share of the surface's motion (a variance) that is left, and whether that
    is no more than noise."""
    window, inside = SMOOTH / dt, _inside(u, dt)
    # Noise of a regressor makes its weight too small: the law is fitted to what is smoothed.
    rows = np.concatenate([columns, [np.linspace(0.0, 1.0, len(u))], np.ones((1, len(u)))])
    slow, target = np.array([_mean(x, window)[inside] for x in rows]), _mean(u, window)[inside]

    def law(lag: float, delay: int) -> tuple[np.ndarray, np.ndarray]:
        # Behind a lag of first order, y - pole y(one earlier) = (1 - pole) x, from the surface's first position, as a
        # banded system: `scipy.signal` is slow to load, and `check` needs this.
        x, n = slow[:, : slow.shape[1] - delay], slow.shape[1] - delay
        pole, first = np.exp(-dt / lag) if lag > 1e-3 * dt else 0.0, np.arange(n) == 0
        bands = np.array([np.ones(n), np.append(np.full(n - 1, -pole), 0.0)])
        driven = np.concatenate([np.where(first, 0.0, (1.0 - pole) * x), [np.where(first, target[delay], 0.0)]])
        *late, free = solve_banded((1, 0), bands, driven.T, check_finite=False).T
        late, forced = np.array(late), target[delay:] - free
        weights = np.linalg.lstsq(late @ late.T, late @ forced, rcond=None)[0]
        return weights, forced - weights @ late

    tried = []
    for delay in (round(d / dt) for d in (0.0, 0.1, 0.2)):
        best = fminbound(lambda lag, d=delay: float(np.var(law(lag, d)[1])), 0.0, most, xtol=1e-3)
        tried += [(float(np.var(law(lag, delay)[1])), lag, delay) for lag in (0.0, float(np.ravel(best)[0]))]
    weights, left = law(*min(tried)[1:])
    # A lag takes noise of the outputs out of fast differences, not out of what is left: it is counted before the lag.
    made = np.abs(weights[: len(columns)])
    noise = float(np.hypot(noise_of(u), np.linalg.norm(made * [noise_of(x) for x in columns])))
    spread, moves = float(np.std(left)), float(np.std(target))
    return made * columns.std(axis=1) / moves, (spread / moves) ** 2, bool(spread < 2.0 * noise / np.sqrt(window))


def _inside(u: np.ndarray, dt: float) -> slice:
    """Samples whose mean over `SMOOTH` does not reach beyond the ends of the record."""
    edge = round(SMOOTH / dt)
    return slice(edge, len(u) - edge)


def _deflection(surface: str, record: FlightRecord) -> Float[np.ndarray, " n"] | None:
    if surface == "aileron" and not record.has(surface) and all(map(record.has, PAIR)):
        return 0.5 * (record[PAIR[0]] - record[PAIR[1]])
    return record.channels.get(surface)


def _banded(x: np.ndarray, dt: float) -> np.ndarray:
    """Smoothed, and without what is slower than a few seconds."""
    return _mean(x, SMOOTH / dt) - _mean(x, SLOW / dt)


def _mean(x: np.ndarray, samples: float) -> np.ndarray:
    half = min(max(1, round(samples / 2.0)), (len(x) - 1) // 2)
    return np.convolve(np.pad(x, half, mode="edge"), np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
