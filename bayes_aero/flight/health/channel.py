"""Faults of one channel: dropouts, frozen, held, idle, quantised, saturated and wrapped samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from bayes_aero.flight.card import Card
from bayes_aero.flight.health import (
    CONTROLS,
    Findings,
    HealthFinding,
    as_filed,
    decided,
    declared,
    different_rates,
    found,
    level_step,
    noise_of,
    quantum,
    quantum_of,
    runs_of,
    same_records,
    short,
    shown,
    span,
    still_runs,
)
from bayes_aero.flight.health.air import air_data, derivatives, in_flight, on_ground
from bayes_aero.flight.health.controls import TURNS, answers_no_input, answers_unmoved, control_responses, feedback
from bayes_aero.flight.health.kinematics import dead_heading, rates_of, refuted, view_of
from bayes_aero.flight.record import FlightRecord

OFF = 8.0  # deviations of the noise, and sizes of the usual step, that a dropout is away from its neighbours
STEPS = 3.5  # recording steps that it is away at least
MOST = 0.25  # share of a record that is a dropout at most: beyond it, the rest would be the exception
STEP = 0.12  # s that a control may not be away: no actuator goes and comes back in that time
CONTINUOUS = 0.95  # share of levels that occur once in a channel whose equal samples are no chance
TRIED = 20  # constants, the most frequent first
USUAL = 0.9  # quantile of the steps that is called usual


def dropouts(record: FlightRecord, card: Card) -> Findings:
    """A finding for each channel with samples at a constant that its neighbours refute."""
    for name, x in record.channels.items():
        if held_period(x):  # each of its steps would be one
            continue
        at, value = dropped(x, record.dt, control=name in CONTROLS)
        if not at.any():
            continue
        filed, unit = float(as_filed(card, name, value)), declared(card, name).unit
        index = np.flatnonzero(at)
        times = ", ".join(f"{record.time[i]:.6g}" for i in index[:3]) + (" ..." if len(index) > 3 else "")
        sentence = (
            f"{name} drops to {filed:.6g} {'' if unit == '1' else unit + ' '}in {len(index)} of {record.n} samples "
            f"(t = {times} s), far from the samples around them: a dropout of the sensor or the recorder; cut these "
            "samples out or interpolate across them in the file"
        )
        yield found(record, name, "dropout", sentence, at=(int(index[0]), int(index[-1])))


def dropped(x: np.ndarray, dt: float, *, control: bool = False) -> tuple[np.ndarray, float]:
    """Which of (n,) samples are dropouts, and the value they stand at; the value with most of them, if several."""
    nothing = np.zeros(len(x), bool)
    steps = np.abs(np.diff(x))
    if len(x) < 8 or not steps.any():
        return nothing, 0.0
    floor = max(OFF * noise_of(x), STEPS * quantum_of(x), 1e-9 * float(np.abs(x).max()))
    away = np.abs(x - median_filter(x, 5, mode="nearest"))
    jumps = np.concatenate([[0.0], steps])
    suspect = np.unique(x[(away > floor) | (jumps > floor)])
    best, value = nothing, 0.0
    levels, counts = np.unique(x, return_counts=True)
    repeated = dict(zip(levels, counts, strict=True))
    often = [level for level in suspect if repeated[level] > 1 or level == 0.0]
    for level in sorted(often, key=lambda level: -repeated[level])[:TRIED]:
        at = _dropped_at(x, level, floor, dt, control=control)
        if at.sum() > best.sum() and (level == 0.0 or sum(1 for _ in runs_of(at)) > 1 or at.sum() > 3):
            best, value = at, float(level)
    continuous = np.mean(counts[levels != value] == 1) > CONTINUOUS
    return (x == value) & (best.any() & continuous) | best, value


def _dropped_at(x: np.ndarray, level: float, floor: float, dt: float, *, control: bool) -> np.ndarray:
    """Samples at a level that lie `floor`, and several usual steps, from the line between their neighbours."""
    at = x == level
    kept = np.flatnonzero(~at)
    if not 0 < at.sum() <= MOST * len(x) or len(kept) < 8:
        return np.zeros(len(x), bool)
    line = np.interp(np.arange(len(x)), kept, x[kept])
    local = np.abs(np.diff(x[kept]))
    pace = np.interp(np.arange(len(x)), kept[1:], median_filter(local, 11, mode="nearest"))
    enough = np.maximum(floor, OFF * np.maximum(pace, 0.25 * np.quantile(local, USUAL)))
    dropped = np.zeros(len(x), bool)
    for first, last in runs_of(at):
        beside = [i for i in (first - 1, last + 1) if 0 <= i < len(x)]
        leaves = all(abs(x[i] - level) > enough[i] for i in beside)
        between = max(enough[first], 3.0 * (last - first + 2) * pace[first])
        returns = len(beside) < 2 or abs(x[beside[0]] - x[beside[1]]) <= between
        short = not control or last - first + 1 <= max(1, STEP / dt)
        if leaves and returns and short and np.abs(line[first : last + 1] - level).min() > enough[first]:
            dropped[first : last + 1] = True
    return dropped


# --- A channel that stands still for longer than its noise allows, while the aircraft moves.

SHORTEST = 0.4  # s: shorter ones are reported as a held signal or do no harm
SURE = 4.0  # times the longest run that chance gives
FROZEN_CONTINUOUS = 0.3  # share of equal neighbours up to which a run of equal values cannot be calm flight
NOISELESS = 1e-5  # noise over range that no sensor has, and a simulation without noise has
ROUNDING = 1.0  # of the last digit: a computed signal scatters by its rounding alone, 0.3 of it
SELDOM = 0.02  # the same of air data, which change slowly
MOTION = ("ax", "ay", "az", "p", "q", "r")
MOVED = {"alpha": 0.009, "beta": 0.015, "theta": 0.009, "phi": 0.015, "psi": 0.02, "airspeed": 1.5, "altitude": 8.0}
ALONG = 50.0  # m of altitude in which the radio altitude cannot stand still
RATES = {"q": ("theta", 0.015), "p": ("phi", 0.03), "r": ("psi", 0.03)}


def frozen(record: FlightRecord, card: Card) -> Findings:
    """A finding for each channel with a stretch in which it does not move though it must."""
    view = view_of(record, card)
    rates = rates_of(view)
    for name, x in record.channels.items():
        if name == "psi" and all(map(record.has, ("theta", "phi", "q", "r"))) and dead_heading(view):
            sentence = (
                f"psi stays at {shown(card, 'psi', float(np.median(x)))} while the rates turn the aircraft: the "
                "heading is dead, and the flight path is reconstructed without it; correct its column or label on the "
                "card, or take it off"
            )
            yield found(record, name, "frozen", sentence, at=(0, record.n - 1), grave=False)
        if np.ptp(x) == 0.0:
            if _must_move(record, name):
                sentence = (
                    f"{name} stands at {shown(card, name, x[0])} throughout: no signal was recorded; correct "
                    "its column or label on the card, or take it off the card"
                )
                grave = name not in ("radio_altitude", "calibrated_airspeed")
                yield found(record, name, "frozen", sentence, at=(0, record.n - 1), grave=grave)
            continue
        if name in CONTROLS:
            stretches = _frozen_control(record, name, x)
        else:
            stretches = [run for run in still_runs(x) if _frozen(record, rates, name, x, run) and not _cut_off(x, run)]
        if not stretches:
            continue
        first, last = max(stretches, key=lambda run: run[1] - run[0])
        more = f", and in {len(stretches) - 1} more stretches" if len(stretches) > 1 else ""
        sentence = (
            f"{name} is frozen at {shown(card, name, x[first])} {span(record, first, last)} ({last - first + 1} equal "
            f"samples{more}), longer than its noise and the other channels allow; cut this part out of the record"
        )
        yield found(record, name, "frozen", sentence, at=(first, last))


def _must_move(record: FlightRecord, name: str) -> bool:
    """Whether flight must move a channel that stands still throughout."""
    if name == "radio_altitude":
        return bool(record.has("altitude") and np.ptp(record["altitude"]) > ALONG)
    if name in CONTROLS:
        surfaces = [n for n in TURNS["elevator"] if record.has(n)]
        return name in surfaces[:1] and answers_no_input(record)
    return name in ("ax", "az", "q", "theta", "airspeed", "calibrated_airspeed") and record.n * record.dt >= 5.0


def _cut_off(x: np.ndarray, run: tuple[int, int]) -> bool:
    """Whether the run is at an end of the channel's range where it stands at other times, too: saturated."""
    value = x[run[0]]
    return bool(value in (x.max(), x.min()) and int(np.sum(x == value)) > 1.2 * (run[1] - run[0] + 1))


def _frozen_control(record: FlightRecord, name: str, x: np.ndarray) -> list[tuple[int, int]]:
    """Runs in which a deflection that scatters elsewhere does not, or that the aircraft answers as if it moved: a
    surface may rest, so that equal samples say nothing of a clean or coarsely rounded signal."""
    runs = [run for run in still_runs(x) if (run[1] - run[0]) * record.dt >= SHORTEST]
    moving = np.delete(x, np.concatenate([np.arange(first, last + 1) for first, last in runs] or [[]]).astype(int))
    share = float(np.mean(np.diff(moving) == 0.0)) if len(moving) > SHORTEST / record.dt else 1.0
    least = np.inf
    if share < FROZEN_CONTINUOUS:
        # Noise above the last digit, not motion: its differences grow with their order, those of third and sixth order
        # of white noise by the root of 924/20, those of motion shrink.
        third, sixth = (float(np.median(np.abs(np.diff(moving, order)))) for order in (3, 6))
        if noise_of(moving) > ROUNDING * quantum(moving) and sixth > 3.0 * third:
            least = SURE * _longest_by_chance(share, len(x))
    return [
        run
        for run in runs
        if (run[1] - run[0] >= least and not _cut_off(x, run) and _others_move(record, name, run))
        or answers_unmoved(record, name, run)
    ]


def _longest_by_chance(share: float, n: int) -> float:
    """Samples of the longest run of equal values among n, of which a share repeats the one before."""
    return max(float(np.log(n)) / -float(np.log(max(share, 1e-3))), 1.0) if share < 1.0 else np.inf


def _frozen(record: FlightRecord, rates: dict[str, np.ndarray], name: str, x: np.ndarray, run: tuple[int, int]) -> bool:
    first, last = run
    length = last - first + 1
    if length * record.dt < SHORTEST or length < 5:
        return False
    equal = np.diff(x) == 0.0
    share = float((equal.sum() - (length - 1)) / max(len(equal) - (length - 1), 1))
    if length < SURE * _longest_by_chance(share, len(x)):
        return False
    moved = None
    if name in RATES and record.has(RATES[name][0]):
        angle, enough = RATES[name]
        turned = record[angle][first : last + 1]
        line = np.linspace(turned[0], turned[-1], len(turned))
        moved = np.inf if float(np.ptp(turned - line)) > enough else None
    elif name in rates and np.isfinite(rates[name]).all():
        rate = rates[name]
        bias = np.median(rate - np.gradient(x, record.time)) if name in ("alpha", "beta") else 0.0
        moved = float(np.ptp(np.cumsum(rate[first : last + 1] - bias) * record.dt))
    if moved is not None:  # by so much as the other channels say
        return moved > max(4.0 * level_step(x), 5.0 * noise_of(x), MOVED.get(name, 0.0))
    noise = noise_of(np.delete(x, np.s_[first : last + 1]))
    scatters = noise > max(NOISELESS * float(np.ptp(x)), ROUNDING * quantum(x))
    often = FROZEN_CONTINUOUS if name in MOTION else SELDOM
    return share < often and scatters and _others_move(record, name, run)


def _others_move(record: FlightRecord, name: str, run: tuple[int, int]) -> bool:
    """Whether the other measured channels go on scattering: a simulation without noise stands still as a whole."""
    part = slice(run[0], run[1] + 1)
    others = [x for other, x in record.channels.items() if other != name and other not in CONTROLS and np.ptp(x) > 0.0]
    return any(float(np.mean(np.diff(x[part]) == 0.0)) < 0.5 for x in others)


# --- A slow signal that was held or linearly interpolated onto a faster time base.

FEWEST = 20  # changes of a channel that a pattern needs
ALIKE = 0.9  # share of the changes that follow the pattern
SLOWEST = 100  # samples between changes at most
CORNERS = 10  # between straight lines that a pattern needs
CLEAR = 30.0  # steps of rounding of the bends at corners that may lie between samples
SPARSE = 6.0  # samples between such corners from which their order is no chance
ENDS, STRAY = 15, 0.02  # lines that do not fit halfway, at least; share of as many that do not fit at the knots
FOLLOW = 0.15  # share of such lines that are followed by another: the answer to a step now and then has none
EVEN = 0.42  # steps of rounding: samples miss lines between rounded ends by the root of 5/36 = 0.37 of one
STRAIGHT = 1e-3  # of the bend at a corner that a straight line may have
ROUNDED = 2.5  # steps of rounding: second differences of a straight line reach two, as each value is off by a half
FAST = frozenset(
    "ax ay az p q r phi theta alpha beta elevator stabilizer rudder aileron aileron_left aileron_right".split()  # noqa: SIM905
)
"""Channels that move within tenths of a second."""


def held(record: FlightRecord, _card: Card) -> Findings:
    """A finding for each channel, or all that share a rate, whose true sampling rate is lower than the record's."""
    slow: dict[tuple[str, float], list[str]] = {}
    for name, x in record.channels.items():
        for how, period in (("held", held_period(x)), ("linearly interpolated", interpolated_period(x))):
            if period:
                slow.setdefault((how, round(period, 1)), []).append(name)
                break
    for (how, period), names in slow.items():
        rate, delay = 1.0 / (period * record.dt), 0.5 * (period - 1.0) * record.dt
        fast = [n for n in names if n in FAST]
        late = f", on average {delay:.2g} s late" if how == "held" else ""
        mend = (
            f"resample the record to that rate (--resample {period * record.dt:.4g}), or record them faster"
            if fast
            else "harmless for a slow signal; do not read its noise as the sensor's"
        )
        them = f"{', '.join(names)} {'is' if len(names) == 1 else 'are'}"
        sentence = (
            f"{them} {how} over {period:.3g} samples: the true rate is {rate:.3g} Hz in a record of "
            f"{1.0 / record.dt:.4g} Hz{late}; {mend}"
        )
        channel = fast[0] if fast else names[0]
        yield found(record, channel, "held", sentence, at=(0, record.n - 1), grave=bool(fast))


def held_period(x: np.ndarray) -> float:
    """Samples for which (n,) values are held, on average; zero if they are not."""
    changes = np.flatnonzero(np.diff(x))
    if len(changes) < FEWEST:
        return 0.0
    lengths, middle, order, off = _spacing(changes)
    if not 2.0 <= middle <= SLOWEST:
        return 0.0
    # Values may repeat from one true sample to the next, and a ratio of rates that is no integer gives two lengths.
    like = off <= (0.0 if middle < 3.0 else 1.0)
    if np.mean(like) < ALIKE or np.mean(order == 1.0) < 0.5 or np.mean(lengths == 1) > 1.0 - ALIKE:
        return 0.0
    return float(np.mean(lengths[like & (order == 1.0)]))


def _spacing(at: Sequence[int] | np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Samples from one to the next, their median, how often it goes into each, and what that misses a time."""
    lengths = np.diff(at)
    middle = float(np.median(lengths))
    order = np.maximum(np.round(lengths / middle), 1.0)
    return lengths, middle, order, np.abs(lengths / order - middle)


def interpolated_period(x: np.ndarray) -> float:
    """Samples between the corners of a signal that is made of straight lines; zero if it is not."""
    bends = np.abs(np.diff(x, 2))
    if len(bends) < 4 * FEWEST or not bends.any():
        return 0.0
    period, step = float(_between_knots(x)), quantum(x)
    large = float(np.sort(bends)[-CORNERS])
    if period or large <= CLEAR * step or len(still_runs(x)) > 0.1 * len(x):
        return period
    bent = bends > max(STRAIGHT * large, ROUNDED * step)
    corners = [first for first, _ in runs_of(bent)]
    if len(corners) <= CORNERS or bent.sum() > 2.1 * len(corners):  # two samples, where a corner falls between them
        return 0.0
    lengths, middle, order, off = _spacing(corners)  # a corner may be too flat to be seen
    regular = middle >= SPARSE and np.mean(off <= 1.0) >= ALIKE and np.mean(order == 1.0) >= 0.5
    return float(lengths.sum() / order.sum()) if regular else 0.0


def _between_knots(x: np.ndarray) -> int:
    """The largest whole period of straight lines between every so many of (n,) values; zero where there is none.
    Rounding moves no sample by more than a step from the line between two others: samples lie that near the lines
    between knots, and further from those between the samples halfway. By chance `ENDS` lines are all of the second kind
    once in 2 to the power of `ENDS`. Knots between samples are not sought."""
    best, step = 0, quantum(x)
    for period in range(2, min(SLOWEST, len(x) // FEWEST) + 1):
        lag = period // 2
        bends = (x[2 * lag :] - 2.0 * x[lag:-lag] + x[: -2 * lag]) ** 2
        corner = int(np.argmax(np.bincount((lag + np.arange(len(bends))) % period, bends, period)))
        on, off = _off_lines(x, corner, period), _off_lines(x, (corner + lag) % period, period)
        limit = 1.001 * max(step, STRAIGHT * float(np.sqrt(np.mean(off**2))))
        stray, ends = np.any(on > limit, axis=1), np.any(off > limit, axis=1)
        if ends.sum() < ENDS or stray.sum() > STRAY * ends.sum() or ends[1:][ends[:-1]].mean() < FOLLOW:
            continue
        if np.sqrt(np.mean(on[~stray] ** 2)) < EVEN * limit:
            best = period
    return best


def _off_lines(x: np.ndarray, first: int, period: int) -> np.ndarray:
    """How far the samples between every `period`-th one are from the line through these, (lines, period - 1)."""
    lines = (len(x) - 1 - first) // period
    part, along = x[first : first + lines * period + 1], np.arange(1, period) / period
    begin, end = part[:-1:period, None], part[period::period, None]
    return np.abs(part[:-1].reshape(lines, period)[:, 1:] - begin - (end - begin) * along)


# --- Long parts of a record in which nothing is flown.

WINDOW = 10.0  # s
CALM = {
    "alpha": np.deg2rad(0.7), "q": np.deg2rad(1.0), "elevator": np.deg2rad(0.5), "stabilizer": np.deg2rad(0.2),
    "phi": np.deg2rad(2.0), "p": np.deg2rad(1.5), "beta": np.deg2rad(1.0), "rudder": np.deg2rad(0.5),
    "aileron": np.deg2rad(0.5), "aileron_left": np.deg2rad(0.5), "airspeed": 2.5,
}  # fmt: skip
"""Ranges within a window, SI, that no manoeuvre stays within."""
LONGEST = 30.0  # s that a manoeuvre may begin or end with


def idle(record: FlightRecord, _card: Card) -> Findings:
    """A finding for the longest part without motion, if it is longer than any entry into a manoeuvre."""
    have = [name for name in CALM if record.has(name)]
    if len(have) < 3 or record.n * record.dt < LONGEST + WINDOW:
        return
    samples = max(3, round(WINDOW / record.dt))
    calm = np.ones(record.n, bool)
    for name in have:
        x = median_filter(record[name], 5, mode="nearest")
        calm &= maximum_filter1d(x, samples) - minimum_filter1d(x, samples) < CALM[name]
    runs = [(a - samples // 2, b + samples // 2) for a, b in runs_of(calm)]
    runs = [(max(a, 0), min(b, record.n - 1)) for a, b in runs]
    runs = [(a, b) for a, b in runs if (b - a) * record.dt >= LONGEST]
    if not runs:
        return
    first, last = max(runs, key=lambda run: run[1] - run[0])
    sentence = (
        f"no manoeuvre is flown {span(record, first, last)} ({', '.join(have[:3])} and "
        "all else hardly move): this part only adds noise; cut it out, or keep it for the estimates of biases"
    )
    yield found(record, "record", "idle", sentence, at=(first, last), grave=False)


# --- A channel recorded in steps that are too coarse for what is asked of it.

COARSEST = {
    "alpha": np.deg2rad(0.45), "beta": np.deg2rad(0.9), "theta": np.deg2rad(0.45), "phi": np.deg2rad(0.9),
    "elevator": np.deg2rad(0.45), "p": np.deg2rad(0.9), "q": np.deg2rad(0.45), "r": np.deg2rad(0.45),
    "ax": 0.2, "ay": 0.2, "az": 0.4, "airspeed": 1.2, "altitude": 15.0, "mach": 0.01, "density": 0.02,
}  # fmt: skip
"""Steps, SI, whose rounding error (a step over the square root of 12) is as large as a good sensor's error is tenfold;
recorders for accident investigation keep 0.2 to 0.35 deg, 0.01 g, 1 kt and are not reported."""
LEVELS = 8  # levels that the motion must cross, at least
CHANGES = 40  # a rounded channel changes its value often; an input in steps, a 3-2-1-1 without noise, some ten times


def quantised(record: FlightRecord, card: Card) -> Findings:
    """A finding for each channel whose step is too coarse in itself or for the motion that is flown."""
    for name, coarsest in COARSEST.items():
        if not record.has(name) or np.count_nonzero(np.diff(record[name])) < CHANGES:
            continue
        x = record[name]
        step = level_step(x)
        moved = float(np.diff(np.quantile(x, (0.005, 0.995)))[0])
        few = name in ("alpha", "q", "az", "elevator") and step > 0.3 * coarsest and moved < LEVELS * step
        if step < coarsest and not few:
            continue
        sentence = (
            f"{name} is recorded in steps of {shown(card, name, step, size=True)}, and the flight crosses "
            f"{moved / step:.0f} of them: its rounding error of {shown(card, name, step / np.sqrt(12.0), size=True)} "
            "is not random noise; record it with more digits, or do not rely on results that use it"
        )
        yield found(record, name, "quantised", sentence, at=(0, record.n - 1))


# --- A channel that is cut off at the end of its range.

SENSED = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "alpha", "beta", "airspeed")
SATURATED_FEWEST = 6  # samples at the limit
SATURATED_LONGEST = 3  # samples in a row of which a noisy channel has none at its very extreme
SATURATED_NOISELESS = 1e-6  # noise over range that no sensor has
NEAR = 4  # samples beside the run, at least, from which the slope is read
SCATTERS = 0.03  # share of equal neighbours elsewhere up to which equal samples at an extreme are no chance
SATURATED_SURE = 3.0  # steps of recording that such a signal scatters by
MORE = 5.0  # recording steps, or deviations of the noise, that the signal would have gone beyond
SATURATED_MOST = 0.5  # share of the record at the limit at most: a channel that stands there is no cut-off peak


def saturated(record: FlightRecord, card: Card) -> Findings:
    """A finding for each measured channel with a flat top or bottom that the signal runs into."""
    for name in SENSED:
        x = record.channels.get(name)
        if x is None or np.ptp(x) == 0.0:
            continue
        for extreme, end in ((float(x.max()), "upper"), (float(x.min()), "lower")):
            run = _flat(x, extreme)
            if run is None:
                continue
            first, last = run
            count = int(np.sum(x == extreme))
            sentence = (
                f"{name} is cut off at {shown(card, name, extreme)}, the {end} end of its range: {count} samples "
                f"stand there, the longest stretch {span(record, first, last)}; the sensor or its converter is "
                "saturated, so cut these parts out or use a sensor of larger range"
            )
            yield found(record, name, "saturated", sentence, at=(first, last))


def _flat(x: np.ndarray, extreme: float) -> tuple[int, int] | None:
    """The longest run at the extreme, where the signal would have gone well beyond it."""
    at = x == extreme
    runs = [(a, b) for a, b in runs_of(at) if a > 0 and b < len(x) - 1]
    if not SATURATED_FEWEST <= int(at.sum()) <= SATURATED_MOST * len(x) or not runs:
        return None
    first, last = max(runs, key=lambda run: run[1] - run[0])
    if last - first + 1 < SATURATED_LONGEST:
        return None
    usual = max(float(np.quantile(np.abs(np.diff(x)), 0.9)), abs(x[first] - x[first - 1]))
    jumps_away = abs(x[last + 1] - x[last]) > 2.0 * usual  # by a step that it does not make on the way in
    if int(at.sum()) <= 1.2 * (last - first + 1) and jumps_away:  # frozen there by chance
        return None
    if noise_of(x) < SATURATED_NOISELESS * np.ptp(x):  # a simulation without noise has exact rests
        return None
    others = np.diff(x)[~(at[1:] & at[:-1])]
    if np.mean(others == 0.0) < SCATTERS and noise_of(x) > SATURATED_SURE * quantum(x):
        return first, last  # a signal that moves by many of its steps from sample to sample rests nowhere by chance
    # It would have gone on beyond the run by half its length at the slope on both sides. A slope read over less than
    # half the run would be that of one step of a rounded peak, which stays below four steps.
    length = last - first + 1
    beside = min(length, max(NEAR, length // 2))
    before, after = max(first - beside, 0), min(last + beside, len(x) - 1)
    into = abs(x[first] - x[before]) / max(first - before, 1)
    out = abs(x[after] - x[last]) / max(after - last, 1)
    step = max(level_step(x), quantum_of(x), quantum(x), noise_of(x))
    return (first, last) if 0.5 * length * min(into, out) > MORE * step else None


# --- Angles that jump where they pass the end of their range.

WITHIN = 4  # samples over which an anti-aliasing filter or an interpolation spreads a jump
WRAPPED_ALIKE = 0.1  # of the jump
WORDS = {"psi": "heading", "phi": "bank angle", "longitude": "longitude"}


def wrapped(record: FlightRecord, _card: Card) -> Findings:
    """A finding for each angle with a jump of a full or half turn within a few samples."""
    for name, word in WORDS.items():
        if not record.has(name):
            continue
        at, turn = jumps(record[name])
        if not len(at):
            continue
        times = ", ".join(f"{record.time[i + 1]:.6g}" for i in at[:3]) + (" ..." if len(at) > 3 else "")
        sentence = (
            f"{name}: the {word} jumps by {turn:.0f} deg {len(at)} times (t = {times} s), where it passes the end "
            "of its range; unwrap it in the file, or its rate is wrong there"
        )
        yield found(record, name, "wrapped", sentence, at=(int(at[0]), int(at[-1]) + 1), grave=name == "phi")


def jumps(x: np.ndarray) -> tuple[np.ndarray, float]:
    """Samples before the jumps of an angle (n,) in rad, and their size in deg; filters may spread one over a few."""
    for turn in (2.0 * np.pi, np.pi):
        spread = np.zeros(len(x) - 1)
        for samples in range(1, WITHIN + 1):
            steps = np.abs(x[samples:] - x[:-samples])
            spread[: len(steps)] = np.maximum(spread[: len(steps)], steps)
        inside = np.flatnonzero(np.abs(spread - turn) < WRAPPED_ALIKE * turn)
        if len(inside):
            return inside[np.diff(inside, prepend=-WITHIN - 9) > WITHIN], float(np.degrees(turn))
    return np.zeros(0, int), 0.0


# --- Every check of a record.

_CHECKS: tuple[Callable[[FlightRecord, Card], Iterable[HealthFinding]], ...] = (
    air_data, derivatives, dropouts, frozen, held, saturated, quantised, wrapped, short, idle, decided,
)  # fmt: skip


def channel_health(records: Sequence[FlightRecord], card: Card) -> tuple[HealthFinding, ...]:
    """Everything that is wrong with records by themselves, one finding a fault; grave findings first."""
    said: list[HealthFinding] = []
    for record in records:
        flown = in_flight(record, card)
        misread, read = refuted(flown, card)
        others = [finding for check in _CHECKS for finding in check(flown, card)]
        findings = _without_consequences([*misread, *others, *control_responses(read, card)])
        if not any(f.channel == "airspeed" and f.fault in ("unit", "airspeed_kind", "factor") for f in findings):
            said += on_ground(record, card)
        said += findings
    said += [*same_records(records), *different_rates(records), *feedback(records, card)]
    return tuple(sorted(said, key=lambda finding: not finding.grave))


def _without_consequences(said: list[HealthFinding]) -> list[HealthFinding]:
    """Each fault of a channel once, without what follows from another one."""
    dropped = {finding.channel for finding in said if finding.fault == "dropout"}
    said = [f for f in said if not (f.fault in ("frozen", "saturated", "quantised") and f.channel in dropped)]
    units, first = [f for f in said if f.fault == "unit"], {}
    for finding in units:
        first.setdefault(finding.channel, finding)
    blamed = {f.channel for f in said if f.fault in ("unit", "airspeed_kind", "density", "factor") and f.grave}
    return [
        f
        for f in said
        if not (f.fault == "unit" and first[f.channel] is not f)
        and not (f.fault == "load" and blamed & {"density", "airspeed", "dynamic_pressure", "static_pressure"})
    ]
