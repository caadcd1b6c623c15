"""A channel that stands still for longer than its noise allows, while the aircraft moves."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.across.controls import TURNS, answers_no_input, answers_unmoved
from bayes_aero.flight.health.across.kinematics import RELATIONS, dead_heading, view_of
from bayes_aero.flight.health.finding import HealthFinding, found, shown, span
from bayes_aero.flight.health.signals import CONTROLS, level_step, noise_of, quantum, still_runs
from bayes_aero.flight.record import FlightRecord

SHORTEST = 0.4  # s: shorter ones are reported as a held signal or do no harm
SURE = 4.0  # times the longest run that chance gives
CONTINUOUS = 0.3  # share of equal neighbours up to which a run of equal values cannot be calm flight
NOISELESS = 1e-5  # noise over range that no sensor has, and a simulation without noise has
ROUNDING = 1.0  # of the last digit: a computed signal scatters by its rounding alone, 0.3 of it
SELDOM = 0.02  # the same of air data, which change slowly
MOTION = ("ax", "ay", "az", "p", "q", "r")
MOVED = {"alpha": 0.009, "beta": 0.015, "theta": 0.009, "phi": 0.015, "psi": 0.02, "airspeed": 1.5, "altitude": 8.0}
ALONG = 50.0  # m of altitude in which the radio altitude cannot stand still
RATES = {"q": ("theta", 0.015), "p": ("phi", 0.03), "r": ("psi", 0.03)}


def frozen(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each channel with a stretch in which it does not move though it must."""
    said = []
    view = view_of(record, card)
    for name, x in record.channels.items():
        if name == "psi" and all(map(record.has, ("theta", "phi", "q", "r"))) and dead_heading(view):
            said.append(found(record, name, "frozen", _dead_heading(card, x), at=(0, record.n - 1), grave=False))
        if np.ptp(x) == 0.0:
            said += _dead(record, card, name)
            continue
        if name in CONTROLS:
            stretches = _frozen_control(record, name, x)
        else:
            stretches = [run for run in still_runs(x) if _frozen(record, view, name, x, run) and not _cut_off(x, run)]
        if not stretches:
            continue
        first, last = max(stretches, key=lambda run: run[1] - run[0])
        more = f", and in {len(stretches) - 1} more stretches" if len(stretches) > 1 else ""
        sentence = (
            f"{name} is frozen at {shown(card, name, x[first])} {span(record, first, last)} ({last - first + 1} equal "
            f"samples{more}), longer than its noise and the other channels allow; cut this part out of the record"
        )
        said.append(found(record, name, "frozen", sentence, at=(first, last)))
    return said


def _dead_heading(card: Card, x: np.ndarray) -> str:
    return (
        f"psi stays at {shown(card, 'psi', float(np.median(x)))} while the rates turn the aircraft: the heading is "
        "dead, and the flight path is reconstructed without it; correct its column or label on the card, or take it off"
    )


def _dead(record: FlightRecord, card: Card, name: str) -> list[HealthFinding]:
    """A channel without any signal, which matters where flight must move it."""
    if name == "radio_altitude":
        if not (record.has("altitude") and np.ptp(record["altitude"]) > ALONG):
            return []
    elif name in CONTROLS:
        surfaces = [n for n in TURNS["elevator"] if record.has(n)]
        if name not in surfaces[:1] or not answers_no_input(record):
            return []
    elif name not in ("ax", "az", "q", "theta", "airspeed", "calibrated_airspeed") or record.n * record.dt < 5.0:
        return []
    grave = name not in ("radio_altitude", "calibrated_airspeed")
    sentence = (
        f"{name} stands at {shown(card, name, record[name][0])} throughout: no signal was recorded; correct its column "
        "or label on the card, or take it off the card"
    )
    return [found(record, name, "frozen", sentence, at=(0, record.n - 1), grave=grave)]


def _cut_off(x: np.ndarray, run: tuple[int, int]) -> bool:
    """Whether the run is at an end of the channel's range where it stands at other times, too: saturated."""
    value = x[run[0]]
    return bool(value in (x.max(), x.min()) and int(np.sum(x == value)) > 1.2 * (run[1] - run[0] + 1))


def _frozen_control(record: FlightRecord, name: str, x: np.ndarray) -> list[tuple[int, int]]:
    """Runs in which a deflection that scatters elsewhere does not, or that the aircraft answers as if it moved.

    A surface may rest, at a stop or where the pilot holds it, a flap in a detent, a lever where it was set: equal
    samples say nothing of a clean or coarsely rounded signal, unless a surface about pitch, roll or yaw moved there.
    """
    runs = [run for run in still_runs(x) if (run[1] - run[0]) * record.dt >= SHORTEST]
    moving = np.delete(x, np.concatenate([np.arange(first, last + 1) for first, last in runs] or [[]]).astype(int))
    share = float(np.mean(np.diff(moving) == 0.0)) if len(moving) > SHORTEST / record.dt else 1.0
    least = SURE * _longest_by_chance(share, len(x)) if share < CONTINUOUS and _scatters(moving) else np.inf
    return [
        run
        for run in runs
        if (run[1] - run[0] >= least and not _cut_off(x, run) and _others_move(record, name, run))
        or answers_unmoved(record, name, run)
    ]


def _longest_by_chance(share: float, n: int) -> float:
    """Samples of the longest run of equal values among n, of which a share repeats the one before."""
    return max(float(np.log(n)) / -float(np.log(max(share, 1e-3))), 1.0) if share < 1.0 else np.inf


def _scatters(x: np.ndarray) -> bool:
    """Whether what is new at each sample is noise above the last digit, not motion: its differences grow with their
    order, those of third and sixth order of white noise by the root of 924/20, those of motion shrink."""
    third, sixth = (float(np.median(np.abs(np.diff(x, order)))) for order in (3, 6))
    return noise_of(x) > ROUNDING * quantum(x) and sixth > 3.0 * third


def _frozen(record: FlightRecord, view: dict[str, np.ndarray], name: str, x: np.ndarray, run: tuple[int, int]) -> bool:
    first, last = run
    length = last - first + 1
    if length * record.dt < SHORTEST or length < 5:
        return False
    equal = np.diff(x) == 0.0
    share = float((equal.sum() - (length - 1)) / max(len(equal) - (length - 1), 1))
    if length < SURE * _longest_by_chance(share, len(x)):
        return False
    moved = _moved(record, view, name, run)
    if moved is not None:
        return moved > max(4.0 * level_step(x), 5.0 * noise_of(x), MOVED.get(name, 0.0))
    noise = noise_of(np.delete(x, np.s_[first : last + 1]))
    scatters = noise > max(NOISELESS * float(np.ptp(x)), ROUNDING * quantum(x))
    often = CONTINUOUS if name in MOTION else SELDOM
    return share < often and scatters and _others_move(record, name, run)


def _moved(record: FlightRecord, view: dict[str, np.ndarray], name: str, run: tuple[int, int]) -> float | None:
    """By how much the other channels say the channel moved in the run; None where they cannot tell."""
    part = slice(run[0], run[1] + 1)
    if name in RATES and record.has(RATES[name][0]):
        angle, least = RATES[name]
        turned = record[angle][part]
        line = np.linspace(turned[0], turned[-1], len(turned))
        return np.inf if float(np.ptp(turned - line)) > least else None
    relation = RELATIONS.get(name)
    if relation is None or any(need not in view for need in relation.needs):
        return None
    rate = relation.rate(view)
    bias = np.median(rate - np.gradient(view[name], view["time"])) if name in ("alpha", "beta") else 0.0
    path = np.cumsum(rate[part] - bias) * record.dt
    return float(np.ptp(path))


def _others_move(record: FlightRecord, name: str, run: tuple[int, int]) -> bool:
    """Whether the other measured channels go on scattering: a simulation without noise stands still as a whole."""
    part = slice(run[0], run[1] + 1)
    others = [x for other, x in record.channels.items() if other != name and other not in CONTROLS and np.ptp(x) > 0.0]
    return any(float(np.mean(np.diff(x[part]) == 0.0)) < 0.5 for x in others)
