"""Signs, units, gravity and kinds of airspeed that the other channels refute, by kinematics at any bank angle."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.across.kinematics import LEVEL, RELATIONS, misfits, view_of
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.health.readings import Reading, readings
from bayes_aero.flight.record import FlightRecord

MENDED = 0.4  # of its misfit a relation may keep under the reading that is said to be right
WORSE = 1.3  # times its misfit another relation may have there, if it is above the limit then
TIED = 0.15  # of the best gain: readings that nearly gain as much cannot be told from the best
MOST = 4  # faults of one record
JUMP = 0.5  # rad from one sample to the next that is no turn
NOUNS = {
    "theta": "pitch attitude", "phi": "bank angle", "psi": "heading", "altitude": "altitude",
    "airspeed": "airspeed", "alpha": "angle of attack", "beta": "sideslip", "level": "normal acceleration",
}  # fmt: skip


def refuted(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each channel that must be read in another way for the record to be one flight."""
    view = {name: _calm(name, x) for name, x in view_of(record, card).items()}
    recorded = frozenset(record.channels) | {"time"} | frozenset(card.constants)
    if record.n < 50:
        return []
    said: list[HealthFinding] = []
    before = misfits(view, recorded)
    for _ in range(MOST):
        if not any(value > 1.0 for value in before.values()):
            break
        tried = [
            (reading, misfits({**view, **reading.applied(view)}, recorded))
            for reading in readings(view, card, recorded)
        ]
        gains = [(_gain(before, after), reading, after) for reading, after in tried]
        gain, best, after = max(gains, key=lambda one: (one[0], -len(one[1].channels)))
        if gain <= 0.0:
            break
        tied = [reading for other, reading, _ in gains if other > (1.0 - TIED) * gain and reading is not best]
        said.append(_finding(record, best, _distinct(best, tied), before, after))
        view, before = {**view, **best.applied(view)}, after
    return said


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
    mended = [n for n, a in before.items() if a > 1.0 and after[n] < MENDED * a]
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
    relation = max((n for n in before if before[n] > 1.0), key=lambda n: min(before[n], 1e6) / max(after[n], 0.05))
    other = "".join(f", or {r.names} {r.looks}" for r in tied)
    sentence = f"{best.names} {best.looks}{other}: {_evidence(relation, before, after)}; {best.mend}"
    return found(record, best.channels[0], best.fault, sentence, at=(0, record.n - 1))


def _evidence(relation: str, before: dict[str, float], after: dict[str, float]) -> str:
    if relation == "level":
        size, left, unit = LEVEL * before["level"], LEVEL * after["level"], "m/s^2 in the mean"
    else:
        angle = relation not in ("altitude", "airspeed")
        scale = RELATIONS[relation].allowed * (np.degrees(1.0) if angle else 1.0)
        unit = "deg" if angle else {"altitude": "m", "airspeed": "m/s"}[relation]
        size, left = scale * before[relation], scale * after[relation]
    return (
        f"the {NOUNS[relation]} differs by {size:.3g} {unit} from what the other channels imply, and by {left:.2g} "
        "once that is corrected"
    )
