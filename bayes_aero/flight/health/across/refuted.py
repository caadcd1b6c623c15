"""Signs, units, gravity and kinds of airspeed that the other channels refute, by kinematics at any bank angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.across.kinematics import LEVEL, RELATIONS, SIDE, View, misfits, side_bias, view_of
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.health.readings import ANGLES, FRAMES, LEFT_HANDED, Reading, framed, readings
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.tolerances import GRAVITY

MENDED = 0.4  # of its misfit a relation may keep under the reading that is said to be right
WORSE = 1.3  # times its misfit another relation may have there, if it is above the limit then
TIED = 0.15  # of the best gain: readings that nearly gain as much cannot be told from the best
MOST = 4  # faults of one record
BESIDE = 1.2  # times a unit's factor, and by which it is divided, where the record must fit worse
FEW, SLOW = 500, 0.1  # samples and s between them that tell one frame from another
ALIKE = 0.3  # logarithm of the misfit within which frames fit alike
TRIED, APART = 16, 3.0  # frames of rates and angles that are followed up, and the same for these
NEARLY = 2.0  # times its limit that a relation may be off in axes that are named: another sensor may be wrong, too
ATTITUDE = frozenset({"theta", "phi", "psi", "altitude"})
MEANS = {"level": LEVEL, "side": SIDE}
JUMP = 0.5  # rad from one sample to the next that is no turn
NOUNS = {
    "theta": "pitch attitude", "phi": "bank angle", "psi": "heading", "altitude": "altitude",
    "airspeed": "airspeed", "alpha": "angle of attack", "beta": "sideslip", "level": "normal acceleration",
}  # fmt: skip


def refuted(record: FlightRecord, card: Card) -> tuple[list[HealthFinding], FlightRecord]:
    """What must be read in another way for the record to be one flight.

    Returns:
        A finding for each such channel or frame, one for each mean acceleration that stays unexplained; and the record
        as it is to be read.
    """
    raw = view_of(record, card)
    view = {name: _calm(name, x) for name, x in raw.items()}
    recorded = frozenset(record.channels) | {"time"} | frozenset(card.constants)
    if record.n < 50:
        return [], record
    before = misfits(view, recorded)
    said, left = _chain(record, card, view, recorded, before)
    if len(said) > 1 or (max(left.values(), default=0.0) > 1.0):
        frame = _frame(view, card, frozenset(record.channels), recorded)
        if frame is not None and len(frame.channels) > 1:
            whole, rest = _chain(record, card, view, recorded, before, frame)
            if whole and max(rest.values()) <= NEARLY and _score(rest) < _score(left) + ALIKE:
                said, left = whole, rest
    for reading, _ in said:
        raw = {**raw, **reading.applied(raw)}
        view = {**view, **reading.applied(view)}
    read = replace(record, channels={name: raw[name] for name in record.channels}) if said else record
    return [*(finding for _, finding in said), *_bias(record, card, view, recorded, left)], read


def _chain(
    record: FlightRecord,
    card: Card,
    view: View,
    recorded: frozenset[str],
    before: dict[str, float],
    first: Reading | None = None,
) -> tuple[list[tuple[Reading, HealthFinding]], dict[str, float]]:
    """Readings one after the other, the best first (or `first`), while any mends what is refuted; and what they leave.

    What they mend must be within the limit in the end: otherwise they explain nothing.
    """
    said: list[tuple[Reading, list[str], HealthFinding]] = []
    for _ in range(MOST):
        if not any(value > 1.0 for value in before.values()):
            break
        one_by_one = readings(view, card, recorded) if first is None or said else [first]
        tried = [(reading, misfits({**view, **reading.applied(view)}, recorded)) for reading in one_by_one]
        gains = [
            (gain if gain <= 0.0 or _own_factor(view, recorded, reading, before, after) else 0.0, reading, after)
            for reading, after in tried
            for gain in (_gain(before, after),)
        ]
        gain, best, after = max(gains, key=lambda one: (one[0], -len(one[1].channels)))
        if gain <= 0.0:
            break
        tied = [reading for other, reading, _ in gains if other > (1.0 - TIED) * gain and reading is not best]
        said.append((best, _mended(before, after), _finding(record, best, _distinct(best, tied), before, after)))
        view, before = {**view, **best.applied(view)}, after
    if all(any(before[name] <= 1.0 for name in mended) for _, mended, _ in said):
        return [(reading, finding) for reading, _, finding in said], before
    return [], before


def _frame(view: View, card: Card, channels: frozenset[str], recorded: frozenset[str]) -> Reading | None:
    """The axes of accelerations and of rates, and the angles that turn with them, that fit best together."""
    step = max(1, min(len(view["time"]) // FEW, int(SLOW / np.median(np.diff(view["time"])))))
    view = {name: x[::step] for name, x in view.items()}
    turned = []
    for angles in dict.fromkeys(tuple(n for n in angles if n in channels) for angles in ANGLES):
        for rates in FRAMES:
            reading = framed(card, channels, {"accelerations": FRAMES[0], "rates": rates}, angles)
            if reading is not None or (rates == FRAMES[0] and not angles):
                seen = view if reading is None else {**view, **reading.applied(view)}
                turned.append((_misfit_of(seen, recorded, ATTITUDE), len(angles), angles, rates))
    turned.sort(key=lambda one: one[:2])
    found = []
    for attitude, _, angles, rates in turned[:TRIED]:
        if attitude > turned[0][0] + APART:
            break
        for forces in (*FRAMES, *LEFT_HANDED):
            reading = framed(card, channels, {"accelerations": forces, "rates": rates}, angles)
            if reading is not None:
                score = _misfit_of({**view, **reading.applied(view)}, recorded)
                found.append((score, len(reading.channels) + 2 * (rates != forces), reading))
    if not found:
        return None
    least = min(score for score, _, _ in found)
    return min((one for one in found if one[0] < least + ALIKE), key=lambda one: one[1])[2]


def _misfit_of(view: View, recorded: frozenset[str], names: frozenset[str] | None = None) -> float:
    return _score(misfits(view, recorded, names))


def _score(found: dict[str, float], floor: float = 0.3) -> float:
    """Sum of the logarithms of misfits; below the floor one is as good as another."""
    return sum(np.log(max(min(value, 1e6), floor)) for value in found.values())


def _own_factor(
    view: View, recorded: frozenset[str], reading: Reading, before: dict[str, float], after: dict[str, float]
) -> bool:
    """Whether the factor of a unit is the one that the record itself asks for: others beside it fit worse.

    A smaller number fits better than a wrong one whatever its unit is.
    """
    if reading.factor == 1.0:
        return True
    names = frozenset(n for n in _mended(before, after) if after[n] != before[n])
    unit = reading.applied(view)
    beside = ({**view, **{n: k * x for n, x in unit.items()}} for k in (BESIDE, 1.0 / BESIDE))
    own = _score({n: after[n] for n in names}, 1e-6)
    return all(_score(misfits(v, recorded, names), 1e-6) > own for v in beside)


def _mended(before: dict[str, float], after: dict[str, float]) -> list[str]:
    """Relations that a reading mends; a mean of the lateral acceleration is a bias before it is anything else."""
    return [n for n, a in before.items() if n != "side" and a > 1.0 and after[n] < MENDED * a]


def _bias(
    record: FlightRecord, card: Card, view: View, recorded: frozenset[str], left: dict[str, float]
) -> list[HealthFinding]:
    """The mean lateral acceleration that no other reading of a channel explains, unless the card states it.

    Bank and turn, which it rests on, must not be in doubt themselves.
    """
    if left.get("side", 0.0) <= 1.0 or max(left.get(name, 0.0) for name in ("phi", "psi")) > 1.0:
        return []
    if "accel_y_bias" in card.effects:
        return []
    off = side_bias(view, recorded)
    tilt = np.degrees(np.arcsin(min(abs(off) / GRAVITY, 1.0)))
    sentence = (
        f"ay is off by {off:+.2g} m/s^2 ({off / GRAVITY:+.2g} g) in the mean: bank, turn and airspeed make "
        f"{float(np.mean(view['ay'])) - off:+.2g} m/s^2, and {float(np.mean(view['ay'])):+.2g} were recorded. It is a "
        f"bias of the accelerometer, or its tilt of {tilt:.2g} deg about the x axis (or as much bias of the bank "
        f"angle); take it out in the file, or add the effect accel_y_bias with its value under fixed on the card"
    )
    return [found(record, "ay", "bias", sentence, at=(0, record.n - 1), grave=Axis.LATERAL in card.axes)]


def _calm(name: str, x: np.ndarray) -> np.ndarray:
    """Without isolated spikes, dropouts and the jumps of an angle, which other checks report."""
    if name == "time":
        return x
    if name in ("psi", "phi"):
        steps = np.diff(x, prepend=x[0])
        x = x[0] + np.cumsum(np.where(np.abs(steps) > JUMP, 0.0, steps))
    return median_filter(x, 5, mode="nearest")


def _gain(before: dict[str, float], after: dict[str, float]) -> float:
    """Logarithm of the misfit that is mended, over all relations; zero where none is, or another is spoiled."""
    mended = _mended(before, after)
    spoiled = [n for n, a in before.items() if after[n] > 1.0 and after[n] > WORSE * a]
    if not mended or spoiled:
        return 0.0
    return sum(np.log(max(min(a, 1e6), 0.3) / max(after[n], 0.3)) for n, a in before.items() if np.isfinite(after[n]))


def _distinct(best: Reading, tied: list[Reading]) -> list[Reading]:
    """Of the readings that are as good, those of other channels."""
    seen, kept = {best.channels}, []
    for reading in tied:
        if not set(reading.channels) & set(best.channels) and reading.channels not in seen:
            seen.add(reading.channels)
            kept.append(reading)
    return kept[:2]


def _finding(
    record: FlightRecord, best: Reading, tied: list[Reading], before: dict[str, float], after: dict[str, float]
) -> HealthFinding:
    relation = max(_mended(before, after), key=lambda n: min(before[n], 1e6) / max(after[n], 0.05))
    other = "".join(f", or {r.names} {r.looks}" for r in tied)
    sentence = f"{best.names} {best.looks}{other}: {_evidence(relation, before, after)}; {best.mend}"
    return found(record, best.channels[0], best.fault, sentence, at=(0, record.n - 1))


def _evidence(relation: str, before: dict[str, float], after: dict[str, float]) -> str:
    if relation in MEANS:
        size, left, unit = MEANS[relation] * before[relation], MEANS[relation] * after[relation], "m/s^2 in the mean"
    else:
        angle = relation not in ("altitude", "airspeed")
        scale = RELATIONS[relation].allowed * (np.degrees(1.0) if angle else 1.0)
        unit = "deg" if angle else {"altitude": "m", "airspeed": "m/s"}[relation]
        size, left = scale * before[relation], scale * after[relation]
    return (
        f"the {NOUNS[relation]} differs by {size:.3g} {unit} from what the other channels imply, and by {left:.2g} "
        "once that is corrected"
    )
