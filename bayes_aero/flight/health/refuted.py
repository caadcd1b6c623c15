"""Signs, units, gravity and kinds of airspeed that the other channels refute, by kinematics at any bank angle."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import fminbound

from bayes_aero.flight.card import Card
from bayes_aero.flight.health.air import OFF
from bayes_aero.flight.health.finding import Findings, HealthFinding, found
from bayes_aero.flight.health.readings import (
    AGREES,
    ATTITUDE,
    FLOW,
    INSTRUMENTS,
    MEANS,
    RELATIONS,
    SCALE,
    SHORTEST,
    Moves,
    Reading,
    View,
    axes_of,
    misfits,
    moved,
    orders,
    readings,
    scaled,
    side_bias,
    terms_of,
    view_of,
)
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import GRAVITY, Axis

MENDED = 0.4  # of its misfit a relation may keep under the reading that is said to be right
WORSE = 1.3  # times its misfit another relation may have there, if it is above the limit then
TIED = 0.15  # of the best gain: readings that nearly gain as much cannot be told from the best
MOST = 4  # faults of one record
BESIDE = np.linspace(-0.18, 0.18, 19)  # logarithms beside a unit's factor, among which the record's own is sought
FEW, SLOW = 500, 0.1  # samples and s between them that tell one sign from another
ALIKE = 2.0  # logarithms of misfits within which ways to read the record may be as good as the best
FAULT, AXES = 0.25, 2  # of these logarithms that a fault costs, and faults that axes cost
TOLD = 0.2  # by which the best must be ahead of the next
SPEED = frozenset({"airspeed", "altitude", "alpha", "beta"})  # relations that ask for a factor of the airspeed
SPEED_ERROR = 0.02  # standard deviation of the scale of an airspeed in the right unit; assumed
PIECE, FEWEST = 5.0, 4  # s, and number, of the pieces that tell its standard error
WIDEST, STEP, SURE = 1.6, 0.02, 3.0  # logarithms of its range and of a difference; standard errors that it must be off
EXPLAINED = 2.0  # times what noise and errors of scale make, up to which a relation holds
JUMP = 0.5  # rad from one sample to the next that is no turn
NOUNS = {
    "theta": "pitch attitude", "phi": "bank angle", "psi": "heading", "altitude": "altitude",
    "airspeed": "airspeed", "alpha": "angle of attack", "beta": "sideslip", "level": "normal acceleration",
}  # fmt: skip
Misfits = dict[str, float]


def refuted(record: FlightRecord, card: Card) -> tuple[list[HealthFinding], FlightRecord]:
    """What must be read in another way for the record to be one flight: a finding for each such channel or frame, one
    for each mean acceleration that stays unexplained; and the record as it is to be read."""
    raw = view_of(record, card)
    view = dict(raw)  # without isolated spikes, dropouts and the jumps of an angle, which other checks report
    for name in set(raw) - {"time"}:
        steps = np.diff(raw[name], prepend=raw[name][0])
        turned = raw[name][0] + np.cumsum(np.where(np.abs(steps) > JUMP, 0.0, steps))
        view[name] = median_filter(turned if name in ("psi", "phi") else raw[name], 5, mode="nearest")
    recorded = frozenset(record.channels) | {"time"} | frozenset(card.constants)
    if record.n < 50:
        return [], record
    before = misfits(view, recorded)
    said, left = _chain(record, card, view, recorded, before)
    if len(said) > 1 or (max(left.values(), default=0.0) > 1.0):
        whole = _whole(record, card, view, recorded, before)
        signs = {r.channels[0] for r, _ in said if r.fault == "sign"}
        if whole is not None and (
            max(left.values()) > 1.0 or whole[0][1].fault == "axes" or signs == set(whole[0][0].channels)
        ):
            said = [whole[0]]
            left = whole[1]
    for reading, _ in said:
        raw = {**raw, **reading.applied(raw)}
        view = {**view, **reading.applied(view)}
    read = replace(record, channels={name: raw[name] for name in record.channels}) if said else record
    return [*(finding for _, finding in said), *_bias(record, card, view, recorded, left)], read


def _chain(
    record: FlightRecord, card: Card, view: View, recorded: frozenset[str], before: Misfits
) -> tuple[list[tuple[Reading, HealthFinding]], Misfits]:
    """Readings one after the other, the best first, while any mends what is refuted; and what they leave. What they
    mend must be within the limit in the end: otherwise they explain nothing."""
    said: list[tuple[Reading, list[str], HealthFinding]] = []
    for _ in range(MOST):
        if not any(value > 1.0 for value in before.values()):
            break
        tried = [(r, _after(view, r, recorded)) for r in readings(view, card, recorded)]
        gains = []
        for reading, after in tried:
            gain = _gain(before, after)
            right = gain <= 0.0 or _own_factor(view, recorded, reading, before, after)
            gains.append((gain if right else 0.0, reading, after))
        if not any(gain > 0.0 and "airspeed" in reading.channels for gain, reading, _ in gains):
            other = [(r, _after(view, r, recorded)) for r in _factors(view, recorded)]
            gains += [(_gain(before, after), reading, after) for reading, after in other]
        gain, best, after = max(gains, key=lambda one: (one[0], -len(one[1].channels)))
        if gain <= 0.0:
            break
        tied = [
            reading
            for other, reading, _ in gains
            if reading is not best and (other > (1.0 - TIED) * gain or (other > 0.0 and _rivals(reading, best)))
        ]
        said.append((best, _mended(before, after), _finding(record, best, _distinct(best, tied), before, after)))
        view, before = {**view, **best.applied(view)}, after
    if all(any(before[name] <= 1.0 for name in mended) for _, mended, _ in said):
        return [(reading, finding) for reading, _, finding in said], before
    return [], before


def _after(view: View, reading: Reading, recorded: frozenset[str]) -> Misfits:
    return misfits({**view, **reading.applied(view)}, recorded)


def _factors(view: View, recorded: frozenset[str]) -> list[Reading]:
    """The airspeed over the factor that fits best; or the altitude, where the altitude alone contradicts it."""
    names = frozenset(misfits(view, recorded, SPEED))
    own = _speed_factor(view, recorded, names)
    if own is None or abs(own[0]) < max(OFF, SURE * own[1]):
        return []
    found = []
    for name, k in (("airspeed", own[0]), ("altitude", -own[0]))[: 2 if names == {"altitude"} else 1]:
        size, error = np.exp(k), np.exp(k) * own[1]
        looks = f"is {size:.4g} +- {error:.1g} times what the other channels make of it (no unit explains it)"
        found.append(scaled((name,), 1.0 / size, "factor", looks, f"correct {name} in the file"))
    return found


def _speed_factor(view: View, recorded: frozenset[str], names: frozenset[str]) -> tuple[float, float] | None:
    """Logarithm of the factor of the airspeed that fits these relations best, and its standard error. The error is that
    of the scatter between pieces of the record, which are taken as independent. None where the record is too short for
    them."""
    pieces = np.array_split(np.arange(len(view["time"])), max(FEWEST, round(np.ptp(view["time"]) / PIECE)))
    if not names or "airspeed" not in recorded or len(pieces[-1]) < SHORTEST:
        return None
    parts = [{name: x[piece] for name, x in view.items()} for piece in pieces]

    def left(k: float) -> np.ndarray:
        read = ({**part, "airspeed": np.exp(-k) * part["airspeed"]} for part in parts)
        return np.array([sum(min(x, 1e6) ** 2 for x in misfits(v, recorded, names).values()) for v in read])

    k = float(np.asarray(fminbound(lambda k: float(np.sum(left(k))), -WIDEST, WIDEST)).flat[0])
    below, at, above = left(k - STEP), left(k), left(k + STEP)
    curve = float(np.sum(above - 2.0 * at + below)) / STEP**2
    error = np.sqrt(len(parts) / (len(parts) - 1) * np.sum(((above - below) / (2.0 * STEP)) ** 2))
    return k, float(error) / max(curve, 1e-12)


def _whole(
    record: FlightRecord, card: Card, view: View, recorded: frozenset[str], before: Misfits
) -> tuple[tuple[Reading, HealthFinding], Misfits] | None:
    """The signs and axes of all channels at once that alone explain the record, but for errors of scale."""
    have = frozenset(record.channels)
    step = max(1, min(len(view["time"]) // FEW, int(SLOW / np.median(np.diff(view["time"])))))
    few = {name: x[::step] for name, x in view.items()}
    names = [n for n in (*ATTITUDE, *FLOW, *INSTRUMENTS["rates"], *INSTRUMENTS["accelerations"]) if n in have]
    signs = np.array(list(product((1, -1), repeat=len(names))))
    turned = [terms_of({**few, name: -few[name]}, recorded) for name in names]
    odd = {  # of each relation, which terms (k, channels) count the other way with a channel
        relation: np.stack([np.sum(x * other[relation], axis=1) < 0.0 for other in turned], axis=1)
        for relation, x in terms_of(few, recorded).items()
    }
    found: list[tuple[float, float, Moves]] = []
    for order in ({**a, **b} for a in orders("rates", have) for b in orders("accelerations", have)):
        other = {**few, **{name: few[source] for name, source in order.items()}}
        strains = _strains(terms_of(other, recorded), odd, signs)
        score, worst = np.log1p(strains**2).sum(0), strains.max(0)
        for k in np.flatnonzero(score < min([score.min(), *(s for s, _, _ in found)]) + ALIKE):
            pairs = {n: (order.get(n, n), int(sign)) for n, sign in zip(names, signs[k], strict=True)}
            found.append((score[k], worst[k], {n: move for n, move in pairs.items() if move != (n, 1)}))
    least = min(score for score, _, _ in found)
    alike = []
    for score, worst, m in found:
        faults = min(len(m), AXES + axes_of(m, have)[1])  # axes are as many as two, beside single channels
        alike += [(score + FAULT * faults, worst, m)] if score < least + ALIKE else []
    total = min(one[0] for one in alike)
    (worst, moves), *tied = sorted(
        ((worst, m) for score, worst, m in alike if score < total + TOLD), key=lambda one: len(one[1])
    )
    reading, *others = (moved(card, have, m) for _, m in ((worst, moves), *tied))
    if not moves or worst > EXPLAINED or (others and any(r.fault == "axes" for r in (reading, *others))):
        return None
    after = misfits({**view, **reading.applied(view)}, recorded)
    if not _mended(before, after):
        return None
    return (reading, _finding(record, reading, others[:2], before, after)), after


def _strains(terms: dict[str, np.ndarray], odd: dict[str, np.ndarray], signs: np.ndarray) -> np.ndarray:
    """Misfit of each relation under each set of signs (sets, channels), over what noise and errors of scale make."""
    found = []
    for name, x in terms.items():
        of_terms = np.where(odd[name][None], signs[:, None, :], 1).prod(2)
        gram = x @ x.T / x.shape[1] if np.isfinite(x).all() else np.full((len(x), len(x)), 1e12)
        off = np.maximum(np.einsum("sk,kl,sl->s", of_terms, gram, of_terms), 0.0)
        found.append(np.sqrt(off / (1.0 + SCALE**2 * np.trace(gram))))
    return np.stack(found)


def _own_factor(view: View, recorded: frozenset[str], reading: Reading, before: Misfits, after: Misfits) -> bool:
    """Whether the factor of a unit agrees with the one that the record itself asks for, which fits best. A smaller
    number fits better than a wrong one whatever its unit is."""
    if reading.factor == 1.0:
        return True
    names = frozenset(n for n in _mended(before, after) if after[n] != before[n])
    speed = _speed_factor(view, recorded, names & SPEED) if reading.channels == ("airspeed",) else None
    if speed is not None:
        return bool(abs(speed[0] + np.log(reading.factor)) < 2.0 * np.hypot(SPEED_ERROR, speed[1]))
    unit = reading.applied(view)
    left = []
    for k in BESIDE:
        off = misfits({**view, **{n: np.exp(k) * x for n, x in unit.items()}}, recorded, names)
        left.append(sum(np.log(max(min(value, 1e6), 1e-6)) for value in off.values()))
    return bool(abs(BESIDE[np.argmin(left)]) < AGREES)


def _mended(before: Misfits, after: Misfits) -> list[str]:
    """Relations that a reading mends; a mean of the lateral acceleration is a bias before it is anything else."""
    return [n for n, a in before.items() if n != "side" and a > 1.0 and after[n] < MENDED * a]


def _bias(record: FlightRecord, card: Card, view: View, recorded: frozenset[str], left: Misfits) -> Findings:
    """The mean lateral acceleration that no other reading of a channel explains, unless the card states it. Bank and
    turn, on which it rests, must not be in doubt. A factor of the airspeed may be a rival."""
    if left.get("side", 0.0) <= 1.0 or max(left.get(name, 0.0) for name in ("phi", "psi")) > 1.0:
        return
    terms = terms_of(view, recorded, frozenset({"side"}))["side"]
    if "accel_y_bias" in card.effects or abs(terms.sum()) < np.sqrt(1.0 + SCALE**2 * np.sum(terms**2)):
        return  # stated there, or no more than errors of scale make in turns
    off = side_bias(view, recorded)
    tilt = np.degrees(np.arcsin(min(abs(off) / GRAVITY, 1.0)))
    mean = float(np.mean(view["ay"]))
    sentence = (
        f"ay is off by {off:+.2g} m/s^2 ({off / GRAVITY:+.2g} g) in the mean: bank, turn and airspeed make "
        f"{mean - off:+.2g} m/s^2, and {mean:+.2g} were recorded. It is a bias of the accelerometer, or its "
        f"tilt of {tilt:.2g} deg about the x axis (or as much bias of the bank angle)"
    )
    # The factor of the airspeed that explains it, too, if no other relation refutes that: what turns grows with the
    # airspeed, what forces make does not.
    turn = side_bias({**view, "airspeed": 2.0 * view["airspeed"]}, recorded) - off
    k = float(turn / (turn - off)) if turn != off else 0.0
    rival = "airspeed" in recorded and np.exp(-WIDEST) < k < np.exp(WIDEST)
    if rival:
        after = misfits({**view, "airspeed": view["airspeed"] / k}, recorded)
        rival = not any(after[n] > max(1.0, WORSE * a) for n, a in left.items())
    mend = (
        f"; or airspeed is {k:.3g} times what bank and turn make of it: this record cannot tell the two apart. Compare "
        "the airspeed with another source"
        if rival
        else "; take it out in the file, or add the effect accel_y_bias with its value under fixed on the card"
    )
    grave = Axis.LATERAL in card.axes
    yield found(record, "ay", "mean" if rival else "bias", sentence + mend, at=(0, record.n - 1), grave=grave)


def _gain(before: Misfits, after: Misfits) -> float:
    """Logarithm of the misfit that is mended, over all relations; zero where none is, or another is spoiled."""
    mended = _mended(before, after)
    spoiled = [n for n, a in before.items() if after[n] > 1.0 and after[n] > WORSE * a]
    if not mended or spoiled:
        return 0.0
    return sum(np.log(max(min(a, 1e6), 0.3) / max(after[n], 0.3)) for n, a in before.items() if np.isfinite(after[n]))


def _distinct(best: Reading, tied: list[Reading]) -> list[Reading]:
    """Of the readings that are as good, those of other channels; and all units that agree."""
    seen, kept = {best.channels}, []
    for reading in tied:
        if _rivals(reading, best):
            kept.append(reading)
        elif not set(reading.channels) & set(best.channels) and reading.channels not in seen:
            seen.add(reading.channels)
            kept.append(reading)
    return kept[:2]


def _rivals(one: Reading, other: Reading) -> bool:
    """Whether they are two units (or kinds of airspeed) of the same channels."""
    return one.channels == other.channels and 1.0 not in (one.factor, other.factor)


def _finding(
    record: FlightRecord, best: Reading, tied: list[Reading], before: Misfits, after: Misfits
) -> HealthFinding:
    relation = max(_mended(before, after), key=lambda n: min(before[n], 1e6) / max(after[n], 0.05))
    other = "".join(f", or {r.names} {r.looks}" for r in tied)
    mend = ", or ".join([best.mend, *(r.mend for r in tied if _rivals(r, best))])
    if relation in MEANS:
        scale, unit = MEANS[relation], "m/s^2 in the mean"
    else:
        unit = {"altitude": "m", "airspeed": "m/s"}.get(relation, "deg")
        scale = RELATIONS[relation].allowed * (np.degrees(1.0) if unit == "deg" else 1.0)
    sentence = (
        f"{best.names} {best.looks}{other}: the {NOUNS[relation]} differs by {scale * before[relation]:.3g} {unit} "
        f"from what the other channels imply, and by {scale * after[relation]:.2g} once that is corrected; {mend}"
    )
    return found(record, best.channels[0], best.fault, sentence, at=(0, record.n - 1))
