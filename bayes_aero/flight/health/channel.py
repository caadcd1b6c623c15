"""Faults of one channel: dropouts, frozen, held, saturated and wrapped samples; and every check there is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter

from bayes_aero.flight import health
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import CONTROLS, Findings, HealthFinding
from bayes_aero.flight.health.air import air_data, in_flight, on_ground
from bayes_aero.flight.health.controls import TURNS, answers_no_input, answers_unmoved, control_responses, feedback
from bayes_aero.flight.health.kinematics import dead_heading, rates_of, refuted, view_of
from bayes_aero.flight.record import FlightRecord

AWAY = 8.0  # deviations of the noise, and sizes of the usual step, that a dropout is away from its neighbours
NOISELESS = 1e-5  # noise over range that no sensor has, and a simulation without noise has
Run = tuple[int, int]  # its first and last sample


def dropouts(record: FlightRecord, card: Card) -> Findings:
    """A finding for each channel with samples at a constant that its neighbours refute."""
    for name, x in record.channels.items():
        if held_period(x):  # each of its steps would be one
            continue
        at, value = _dropped(x, record.dt, name in CONTROLS)
        if at.any():
            filed, unit = float(health.as_filed(card, name, value)), health.declared(card, name).unit
            index = np.flatnonzero(at)
            yield health.finding(
                record, name, "dropout",
                (f"{name} drops to {filed:.6g} {unit} in {len(index)} of {record.n} samples".replace(" 1 in", " in"),
                f" ({health.when(record, index)}), far from the samples around them: a dropout",
                "cut these samples out or interpolate across them in the file"), (int(index[0]), int(index[-1])),
            )  # fmt: skip


def _dropped(x: np.ndarray, dt: float, control: bool) -> tuple[np.ndarray, float]:
    """Which of (n,) samples are dropouts, and the value they stand at; the value with most of them, if several."""
    best, value, steps = np.zeros(len(x), bool), 0.0, np.abs(np.diff(x, prepend=x[:1]))
    if len(x) < 8 or not steps.any():
        return best, value
    steps_away = 3.5 * health.quantum_of(x)  # recording steps
    floor = max(AWAY * health.noise_of(x), steps_away, 1e-9 * float(np.abs(x).max()))
    away = np.abs(x - median_filter(x, 5, mode="nearest"))
    levels, counts = np.unique(x, return_counts=True)
    suspect = np.isin(levels, x[np.maximum(away, steps) > floor]) & ((counts > 1) | (levels == 0.0))
    for level in levels[suspect][np.argsort(-counts[suspect], kind="stable")][:20]:  # the most frequent first
        at = _dropped_at(x, level, floor, dt, control)
        if at.sum() > best.sum() and (level == 0.0 or len(health.runs_of(at)) > 1 or at.sum() > 3):
            best, value = at, float(level)
    # Equal samples are no chance in a channel whose other levels occur once.
    continuous = np.mean(counts[levels != value] == 1) > 0.95
    return (x == value) & (best.any() & continuous) | best, value


def _dropped_at(x: np.ndarray, level: float, floor: float, dt: float, control: bool) -> np.ndarray:
    """Samples at a level that lie `floor`, and several usual steps, from the line between their neighbours."""
    at, dropped, index = x == level, np.zeros(len(x), bool), np.arange(len(x))
    kept = np.flatnonzero(~at)
    if not 0 < at.sum() <= 0.25 * len(x) or len(kept) < 8:  # beyond a quarter, the rest would be the exception
        return dropped
    line, local = np.interp(index, kept, x[kept]), np.abs(np.diff(x[kept]))
    pace = np.interp(index, kept[1:], median_filter(local, 11, mode="nearest"))
    enough = np.maximum(floor, AWAY * np.maximum(pace, 0.25 * np.quantile(local, 0.9)))
    for first, last in health.runs_of(at):
        beside = [i for i in (first - 1, last + 1) if 0 <= i < len(x)]
        leaves = all(abs(x[i] - level) > enough[i] for i in beside)
        returns = len(beside) < 2 or np.ptp(x[beside]) <= max(enough[first], 3.0 * (last - first + 2) * pace[first])
        brief = not control or last - first + 1 <= max(1, 0.12 / dt)  # no actuator goes and comes back in 0.12 s
        if leaves and returns and brief and np.abs(line[first : last + 1] - level).min() > enough[first]:
            dropped[first : last + 1] = True
    return dropped


# --- A channel that stands still for longer than its noise allows, while the aircraft moves.

SHORTEST = 0.4  # s: shorter ones are reported as a held signal or do no harm
SURE = 4.0  # times the longest run that chance gives
CONTINUOUS = 0.3  # share of equal neighbours up to which a run of equal values cannot be calm flight
SELDOM = 0.02  # the same of air data, which change slowly
MOVED = {"alpha": 0.009, "beta": 0.015, "theta": 0.009, "phi": 0.015, "psi": 0.02, "airspeed": 1.5, "altitude": 8.0}
RATES = {"q": ("theta", 0.015), "p": ("phi", 0.03), "r": ("psi", 0.03)}
"""The angle of each rate, and rad by which it must leave a straight line."""


def frozen(record: FlightRecord, card: Card) -> Findings:
    """A finding for each channel with a stretch in which it does not move though it must."""
    view = view_of(record, card)
    rates = rates_of(view)
    for name, x in record.channels.items():
        if name == "psi" and all(map(record.has, ("theta", "phi", "q", "r"))) and dead_heading(view):
            yield health.finding(
                record, name, "frozen",
                (f"psi stays at {health.shown(card, 'psi', float(np.median(x)))} while the rates turn the aircraft",
                ": the heading is dead, and the flight path is reconstructed without it",
                "correct its column or label on the card, or take it off"), grave=False,
            )  # fmt: skip
        runs = [(a, b + 1) for a, b in health.runs_of(np.diff(x) == 0.0) if (b + 1 - a) * record.dt >= SHORTEST]
        if np.ptp(x) == 0.0:
            if _must_move(record, name):
                yield health.finding(
                    record, name, "frozen",
                    (f"{name} stands at {health.shown(card, name, x[0])} throughout", ": no signal was recorded",
                    "correct its column or label on the card, or take it off the card"),
                    grave=name not in ("radio_altitude", "calibrated_airspeed"),
                )  # fmt: skip
        elif runs := (_stuck_surface(record, name, runs) if name in CONTROLS else _stuck(record, rates, name, runs)):
            first, last = health.longest(runs)
            more = f", and in {len(runs) - 1} more stretches" if len(runs) > 1 else ""
            yield health.finding(
                record, name, "frozen",
                (f"{name} is frozen at {health.shown(card, name, x[first])} {health.span(record, first, last)}",
                f" ({last - first + 1} equal samples{more}), longer than its noise and the other channels allow",
                "cut this part out of the record"), (first, last),
            )  # fmt: skip


def _must_move(record: FlightRecord, name: str) -> bool:
    if name == "radio_altitude":
        return bool(record.has("altitude") and np.ptp(record["altitude"]) > 50.0)
    if name in CONTROLS:
        return name in [n for n in TURNS["elevator"] if record.has(n)][:1] and answers_no_input(record)
    return name in ("ax", "az", "q", "theta", "airspeed", "calibrated_airspeed") and record.n * record.dt >= 5.0


def _cut_off(x: np.ndarray, run: Run) -> bool:
    """Whether the run is at an end of the channel's range where it stands at other times, too: saturated."""
    value = x[run[0]]
    return bool(value in (x.max(), x.min()) and int(np.sum(x == value)) > 1.2 * (run[1] - run[0] + 1))


def _chance(share: float, n: int) -> float:
    """Samples of the longest run of equal values among n, of which a share repeats the one before, and then some."""
    return SURE * max(float(np.log(n)) / -float(np.log(max(share, 1e-3))), 1.0) if share < 1.0 else np.inf


def _others_move(record: FlightRecord, name: str, run: Run) -> bool:
    """Whether the other measured channels go on scattering: a simulation without noise stands still as a whole."""
    others = [x for n, x in record.channels.items() if n != name and n not in CONTROLS and np.ptp(x) > 0.0]
    return any(float(np.mean(np.diff(x[run[0] : run[1] + 1]) == 0.0)) < 0.5 for x in others)


def _stuck_surface(record: FlightRecord, name: str, runs: list[Run]) -> list[Run]:
    """Runs in which a deflection that scatters elsewhere does not, or that the aircraft answers as if it moved: a
    surface may rest, so that equal samples say nothing of a clean or coarsely rounded signal."""
    x, least = record[name], np.inf
    moving = np.delete(x, np.concatenate([np.arange(a, b + 1) for a, b in runs] or [[]]).astype(int))
    share = float(np.mean(np.diff(moving) == 0.0)) if len(moving) > SHORTEST / record.dt else 1.0
    if share < CONTINUOUS and health.noise_of(moving) > health.quantum(moving):
        # Noise above the last digit, not motion: its differences grow with their order, those of third and sixth order
        # of white noise by the root of 924/20, those of motion shrink.
        third, sixth = (float(np.median(np.abs(np.diff(moving, order)))) for order in (3, 6))
        least = _chance(share, len(x)) if sixth > 3.0 * third else least
    return [
        run for run in runs
        if (run[1] - run[0] >= least and not _cut_off(x, run) and _others_move(record, name, run))
        or answers_unmoved(record, name, run)
    ]  # fmt: skip


def _stuck(record: FlightRecord, rates: dict[str, np.ndarray], name: str, runs: list[Run]) -> list[Run]:
    x, stuck = record[name], []
    equal = np.diff(x) == 0.0
    for first, last in runs:
        part, length, moved = slice(first, last + 1), last - first + 1, None
        share = float((equal.sum() - (length - 1)) / max(len(equal) - (length - 1), 1))
        if length < max(5, _chance(share, len(x))) or _cut_off(x, (first, last)):
            continue
        if name in RATES and record.has(RATES[name][0]):
            turned = record[RATES[name][0]][part]
            moved = np.inf if np.ptp(turned - np.linspace(turned[0], turned[-1], length)) > RATES[name][1] else None
        elif name in rates and np.isfinite(rates[name]).all():
            bias = np.median(rates[name] - np.gradient(x, record.time)) if name in ("alpha", "beta") else 0.0
            moved = float(np.ptp(np.cumsum(rates[name][part] - bias) * record.dt))
        if moved is not None:  # by so much as the other channels say
            step = health.quantum_of(np.delete(x, np.s_[part]))
            frozen = moved > max(4.0 * step, 5.0 * health.noise_of(x), MOVED.get(name, 0.0))
        else:
            # A computed signal scatters by its rounding alone, 0.3 of the last digit.
            scatters = health.noise_of(np.delete(x, np.s_[part])) > max(NOISELESS * float(np.ptp(x)), health.quantum(x))
            often = CONTINUOUS if name in ("ax", "ay", "az", "p", "q", "r") else SELDOM
            frozen = share < often and scatters and _others_move(record, name, (first, last))
        stuck += [(first, last)] if frozen else []
    return stuck


# --- A slow signal that was held or linearly interpolated onto a faster time base.

FEWEST, SLOWEST = 20, 100  # changes of a channel that a pattern needs; samples between changes at most
ALIKE = 0.9  # share of the changes that follow the pattern
LINES = 15  # that do not fit halfway between knots, at least
STRAIGHT = 1e-3  # of the bend at a corner that a straight line may have
FAST = frozenset(
    "ax ay az p q r phi theta alpha beta elevator stabilizer rudder aileron aileron_left aileron_right".split()  # noqa: SIM905
)
"""Channels that move within tenths of a second."""


def held(record: FlightRecord, _card: Card) -> Findings:
    """A finding for each channel, or all that share a rate, whose true sampling rate is lower than the record's."""
    slow: dict[tuple[str, float], list[str]] = {}
    for name, x in record.channels.items():
        period, how = held_period(x), "held"
        if not period:
            period, how = interpolated_period(x), "linearly interpolated"
        if period:
            slow.setdefault((how, round(period, 1)), []).append(name)
    for (how, period), names in slow.items():
        fast = [n for n in names if n in FAST]
        late = f", on average {0.5 * (period - 1.0) * record.dt:.2g} s late" if how == "held" else ""
        mend = "harmless for a slow signal; do not read its noise as the sensor's"
        if fast:
            mend = f"resample the record to that rate (--resample {period * record.dt:.4g}), or record them faster"
        yield health.finding(
            record, (fast or names)[0], "held",
            (f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} {how} over {period:.3g} samples: the true rate "
            f"is {1.0 / (period * record.dt):.3g} Hz in a record of {1.0 / record.dt:.4g} Hz", late, mend),
            grave=bool(fast),
        )  # fmt: skip


def held_period(x: np.ndarray) -> float:
    """Samples for which (n,) values are held, on average; zero if they are not."""
    changes = np.flatnonzero(np.diff(x))
    if len(changes) < FEWEST:
        return 0.0
    lengths = np.diff(changes)
    middle = float(np.median(lengths))
    order = np.maximum(np.round(lengths / middle), 1.0)  # how often it goes into each
    off = np.abs(lengths / order - middle)
    # Values may repeat from one true sample to the next, and a ratio of rates that is no integer gives two lengths.
    like, once = off <= (0.0 if middle < 3.0 else 1.0), order == 1.0
    rhythm = 2.0 <= middle <= SLOWEST and np.mean(like) >= ALIKE and np.mean(lengths == 1) <= 1.0 - ALIKE
    return float(np.mean(lengths[like & once])) if rhythm and np.mean(once) >= 0.5 else 0.0


def interpolated_period(x: np.ndarray) -> int:
    """The largest whole period of straight lines between every so many of (n,) values; zero where there is none.
    Rounding moves no sample by more than a step from the line between two others: samples lie that near the lines
    between knots, and further from those between the samples halfway. By chance `LINES` lines are all of the second
    kind once in 2 to the power of `LINES`. Knots between samples are not sought."""
    if len(x) < 4 * FEWEST or not np.diff(x, 2).any():
        return 0
    best, step = 0, health.quantum(x)

    def off_lines(first: int, period: int) -> np.ndarray:
        """How far samples are from the line between every `period`-th one, (lines, period - 1)."""
        lines = (len(x) - 1 - first) // period
        rows = x[first : first + lines * period].reshape(lines, period)
        end = x[first + period :: period][:lines, None]
        return np.abs(rows[:, 1:] - rows[:, :1] - (end - rows[:, :1]) * np.arange(1, period) / period)

    for period in range(2, min(SLOWEST, len(x) // FEWEST) + 1):
        lag = period // 2
        bends = (x[2 * lag :] - 2.0 * x[lag:-lag] + x[: -2 * lag]) ** 2
        corner = int(np.argmax(np.bincount((lag + np.arange(len(bends))) % period, bends, period)))
        on, off = off_lines(corner, period), off_lines((corner + lag) % period, period)
        limit = 1.001 * max(step, STRAIGHT * float(np.sqrt(np.mean(off**2))))
        stray, bent = np.any(on > limit, axis=1), np.any(off > limit, axis=1)
        # The answer to a step now and then has no lines that follow each other.
        if bent.sum() < LINES or stray.sum() > 0.02 * bent.sum() or bent[1:][bent[:-1]].mean() < 0.15:
            continue
        if np.sqrt(np.mean(on[~stray] ** 2)) < 0.42 * limit:  # between rounded ends, the root of 5/36 = 0.37 of a step
            best = period
    return best


# --- A channel that is cut off at the end of its range, or jumps there.

SENSED = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "alpha", "beta", "airspeed")


def saturated(record: FlightRecord, card: Card) -> Findings:
    """A finding for each measured channel with a flat top or bottom that the signal runs into."""
    for name in SENSED:
        x = record.channels.get(name, np.zeros(1))
        for extreme, end in ((float(x.max()), "upper"), (float(x.min()), "lower")):
            if run := _flat(x, extreme):
                yield health.finding(
                    record, name, "saturated",
                    (f"{name} is cut off at {health.shown(card, name, extreme)}, the {end} end of its range",
                    f": {int(np.sum(x == extreme))} samples stand there, most {health.span(record, *run)}",
                    "cut these parts out or use a sensor of larger range"), run,
                )  # fmt: skip


def _flat(x: np.ndarray, extreme: float) -> Run | None:
    """The longest run at the extreme, where the signal would have gone well beyond it."""
    at, steps, noise = x == extreme, np.diff(x), health.noise_of(x)
    runs = [(a, b) for a, b in health.runs_of(at) if a > 0 and b < len(x) - 1]
    if not 6 <= int(at.sum()) <= 0.5 * len(x) or not runs:  # a channel that stands there is no cut-off peak
        return None
    first, last = health.longest(runs)
    length = last - first + 1
    usual = max(float(np.quantile(np.abs(steps), 0.9)), abs(x[first] - x[first - 1]))
    by_chance = int(at.sum()) <= 1.2 * length and abs(x[last + 1] - x[last]) > 2.0 * usual  # frozen, then jumps away
    if length < 3 or by_chance or noise < 0.1 * NOISELESS * np.ptp(x):
        return None
    if np.mean(steps[~(at[1:] & at[:-1])] == 0.0) < 0.03 and noise > 3.0 * health.quantum(x):
        return first, last  # a signal that moves by many of its steps from sample to sample rests nowhere by chance
    # It would have gone on beyond the run by half its length at the slope on both sides. A slope read over less than
    # half the run would be that of one step of a rounded peak, which stays below four steps.
    beside = min(length, max(4, length // 2))
    before, after = max(first - beside, 0), min(last + beside, len(x) - 1)
    slope = min(abs(x[first] - x[before]) / (first - before), abs(x[after] - x[last]) / (after - last))
    step = max(health.quantum_of(x), health.quantum(x), noise)
    return (first, last) if 0.5 * length * slope > 5.0 * step else None


def wrapped(record: FlightRecord, _card: Card) -> Findings:
    """A finding for each angle with a jump of a full or half turn where it passes the end of its range."""
    for name, word in {"psi": "heading", "phi": "bank angle", "longitude": "longitude"}.items():
        x, within = record.channels.get(name, np.zeros(9)), 4  # samples that a filter spreads a jump over
        steps = [np.abs(x[k:] - x[:-k]) for k in range(1, within + 1)]
        spread = np.max([np.pad(step, (0, len(x) - 1 - len(step))) for step in steps], axis=0)
        for turn in (2.0 * np.pi, np.pi):
            at = np.flatnonzero(np.abs(spread - turn) < 0.1 * turn)
            at = at[np.diff(at, prepend=-within - 9) > within]
            if len(at):
                yield health.finding(
                    record, name, "wrapped",
                    (f"{name}: the {word} jumps by {np.degrees(turn):.0f} deg {len(at)} times",
                    f" ({health.when(record, at + 1)}) at the end of its range", "unwrap it in the file"),
                    (int(at[0]), int(at[-1]) + 1), grave=name == "phi",
                )  # fmt: skip
                break


# --- Every check of a record.

_CHECKS = (air_data, dropouts, frozen, held, saturated, wrapped, health.short, health.decided)


def channel_health(records: Sequence[FlightRecord], card: Card) -> tuple[HealthFinding, ...]:
    """Everything that is wrong with records by themselves, one finding a fault; grave findings first."""
    findings: list[HealthFinding] = []
    for record in records:
        flown = in_flight(record, card)
        misread, read = refuted(flown, card)
        others = [finding for check in _CHECKS for finding in check(flown, card)]
        of_record = _without_consequences([*misread, *others, *control_responses(read, card)])
        if not any(f.channel == "airspeed" and f.fault in ("unit", "airspeed_kind", "factor") for f in of_record):
            findings += on_ground(record, card)
        findings += of_record
    findings += [*health.same_records(records), *health.different_rates(records), *feedback(records, card)]
    return tuple(sorted(findings, key=lambda f: not f.grave))


def _without_consequences(findings: list[HealthFinding]) -> list[HealthFinding]:
    """Each fault of a channel once, without what follows from another one."""
    dropped = {f.channel for f in findings if f.fault == "dropout"}
    blamed = {f.channel for f in findings if f.fault in ("unit", "airspeed_kind", "density", "factor") and f.grave}
    kept: list[HealthFinding] = []
    for f in findings:
        follows = f.fault in ("frozen", "saturated") and f.channel in dropped
        twice = f.fault == "unit" and any(k.fault == "unit" and k.channel == f.channel for k in kept)
        heavy = f.fault == "load" and blamed & {"density", "airspeed", "dynamic_pressure", "static_pressure"}
        kept += [] if follows or twice or heavy else [f]
    return kept
