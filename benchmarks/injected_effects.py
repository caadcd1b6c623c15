"""Inject sensor errors, trim and thrust effects into real records and look whether they are found on top of the rest.

    python benchmarks/injected_effects.py RECORD RECORD [--draws 1] [--seed 0]

Each effect of `INJECTED` at a random size within its range, either sign. `errors` is what the records then hold of it
(what was named before, and the injected one) in standard errors of its first screening: could they show it at all?
Found: named with a size that moved by the injected one, against the diagnosis of the records as they are; or no longer
named, where the injected one cancels it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from studies import CLEAR, diagnosed, plain_parser, records_of, share, standard_scores

from bayes_aero.diagnosis.selection_state import DERIVED
from bayes_aero.effect import NEUTRAL_FLOW, Effect, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import plain_marks, with_sums
from bayes_aero.physics.coefficients import condition_joined
from bayes_aero.simulate.injection import misrecorded

INJECTED = {  # range of the absolute value of its parameter, SI
    "alpha_bias": (0.01, 0.04), "alpha_scale": (0.04, 0.10), "airspeed_bias": (1.5, 12.0),
    "airspeed_scale": (0.02, 0.15), "pitch_rate_bias": (0.004, 0.012), "pitch_rate_scale": (0.04, 0.10),
    "accel_x_bias": (0.1, 0.3), "accel_z_bias": (0.2, 0.6), "stabilizer_trim": (1.0, 2.0),
    "thrust_moment": (0.5, 1.0), "thrust_scale": (0.1, 0.3),
}  # fmt: skip


def sizes_of(found) -> dict[str, tuple[float, float]]:
    """Every parameter of a named cause: mean and deviation."""
    return {p: (s.mean, s.sd) for c in found.causes for p, s in c.parameters.items()}


def main() -> None:
    parser = plain_parser(__doc__)
    parser.add_argument("--only", nargs="+", choices=sorted(INJECTED), default=list(INJECTED))
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    given, card, records = records_of(parser)
    plain = diagnosed(records, card, given.seed)[0]
    before = sizes_of(plain)
    Cmde = plain.base_moves["Cmde"][1]  # of the extended model, in which a moment has to be held
    print(f"elevator effectiveness of the extended model {Cmde:.3f} 1/rad")
    rng = np.random.default_rng(given.seed)
    rows = []
    print(f"{'effect':17s} {'injected':>9s} {'errors':>6s} {'moved':>9s}  named")
    for name in given.draws * given.only:
        parameter = CATALOGUE[name].parameters[0].name
        size = float(rng.choice([-1.0, 1.0]) * rng.uniform(*INJECTED[name]))
        found = diagnosed(injected(records, {name: {parameter: size}}, card, Cmde=Cmde), card, given.seed)[0]
        old, new = before.get(parameter, (0.0, 0.0)), sizes_of(found).get(parameter)
        also = [c.name for c in found.causes if name in c.ambiguous_with]
        wanted = size * (1.0 + old[0]) if parameter.endswith("_scale") else size  # scale factors multiply
        errors = standard_scores(found, {name: {parameter: old[0] + wanted}}).get(name, 0.0)
        least = CATALOGUE[name].sizes[parameter][0]
        cancels = new is None and abs(old[0] + wanted) < least  # what was there before is gone, and rightly unnamed
        by = "itself" if new else "cancelled" if cancels else f"within {also[0]}" if also else "no"
        moved = new[0] - old[0] if new else -old[0] if cancels else float("nan")
        allowed = least if cancels else 1.96 * np.hypot(old[1], new[1] if new else 0.0) + 0.1 * abs(size)
        rows.append((by != "no", errors >= CLEAR, bool(abs(moved - wanted) < allowed)))
        print(f"{name:17s} {size:9.4g} {errors:6.1f} {moved:9.4g}  {by}", flush=True)
    clear = share(named for named, clear, _ in rows if clear)
    print(f"of at least {CLEAR:g} standard errors: named, in an ambiguity set, or cancelled {clear}")
    print(f"all: named, in an ambiguity set, or cancelled {share(row[0] for row in rows)}; moved by the injected size "
          f"(within the intervals and a tenth) {share(row[2] for row in rows)}")  # fmt: skip


POSSIBLE = "only sensors, thrust and moments can be injected into a record"


def injected(
    records: Sequence[FlightRecord], effects: Mapping[str, Mapping[str, float]], card: Card, *, Cmde: float
) -> list[FlightRecord]:
    """The records as they would be if the aircraft had flown the same motion with `effects` (by name, values) in it.

    Sensor errors and thrust: what the faulty installation would have recorded of this flight. Effects on the pitching
    moment alone: the motion stays as it was if the pilot holds against them, so the elevator takes -dCm/Cmde, `Cmde`
    being its effectiveness, 1/rad; the lift of a force at the tail goes with it. Effects on lift or drag cannot be
    had without other motion, and are refused.
    """
    for name in effects:
        if name not in CATALOGUE:
            raise InputError(f"there is no effect {name!r} to inject; the catalogue has {', '.join(CATALOGUE)}")
    return [_one(record, effects, card, Cmde) for record in records]


def _one(record: FlightRecord, effects: Mapping[str, Mapping[str, float]], card: Card, Cmde: float) -> FlightRecord:
    given = {name: np.asarray(x) for name, x in with_sums(record, card).items()}
    channels = dict(given)
    dt = record.dt
    for name, values in effects.items():
        effect = CATALOGUE[name]
        missing = [c for c in effect.channels if c not in channels and c not in DERIVED]
        if missing:
            raise InputError(f"effect {name} needs channel {', '.join(missing)}, which {record.name} does not have")
        if effect.stage is Stage.CHANNEL:
            channels |= misrecorded(Model.of([effect]), values, channels, plain_marks(record.n, dt), card.aircraft)
        else:
            moment = _moment(effect, values, channels, dt, card)
            channels["elevator"] = channels["elevator"] - moment / Cmde
    for name, parts in card.sums.items():
        channels |= _shared(parts, channels[name], {part: given[part] for part in parts})
    changed = {name for name in given if name not in card.sums and not np.array_equal(given[name], channels[name])}
    kept = {name: x for name, x in channels.items() if record.has(name) or name in changed}
    return FlightRecord.from_arrays(record.name, np.asarray(record.time), kept, f"{record.source}, effects injected")


def _shared(parts: Mapping[str, float], total: np.ndarray, given: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A sum that was changed, shared among its parts: plain sums as it was shared, others by the parts' factors."""
    before = sum(factor * given[part] for part, factor in parts.items())
    if all(factor == 1.0 for factor in parts.values()):
        ratio = total / np.where(before == 0.0, 1.0, before)
        return {part: x * ratio for part, x in given.items()}
    square = sum(factor**2 for factor in parts.values())
    return {part: x + (total - before) * parts[part] / square for part, x in given.items()}


def _moment(
    effect: Effect, values: Mapping[str, float], channels: Mapping[str, np.ndarray], dt: float, card: Card
) -> np.ndarray:
    n = len(channels["alpha"])
    ends = jnp.full(n, dt), jnp.zeros(n, int), jnp.full(n, n - 1)
    signals = condition_joined({name: jnp.asarray(x) for name, x in channels.items()}, *ends)
    ones = jnp.ones(n)

    def increments(X: float) -> dict[str, Any]:
        known = {name: value * ones for name, value in NEUTRAL_FLOW.items()} | {"incidence": signals["alpha"]}
        found = effect.increments(values, signals, card.aircraft, known | {"X": X * ones})
        return {name: np.asarray(x) * np.ones(len(ones)) for name, x in found.items()}

    if effect.uses:
        raise InputError(
            f"effect {effect.name} rests on parameters of other effects ({', '.join(effect.uses)}); {POSSIBLE}"
        )
    if effect.stage < Stage.ATTACHED:
        raise InputError(f"effect {effect.name} changes the flow or the aircraft; {POSSIBLE}")
    found, apart = increments(1.0), increments(0.5)
    if any(not np.allclose(found[name], apart[name]) for name in found):
        raise InputError(f"effect {effect.name} depends on separation, which no record knows; {POSSIBLE}")
    moment = found.get("Cm", np.zeros(len(ones)))
    # A force at the tail is held by the elevator's, which acts there too: lift and moment vanish together.
    lift_of_tail = -moment * card.aircraft.chord / card.aircraft.tail_arm
    if not (set(found) <= {"Cm", "CL_attached"} and np.allclose(found.get("CL_attached", lift_of_tail), lift_of_tail)):
        raise InputError(f"effect {effect.name} changes more than the pitching moment; {POSSIBLE}")
    if not np.any(moment):
        raise InputError(f"effect {effect.name} makes no moment in this record; what it acts through does not move")
    return moment


if __name__ == "__main__":
    main()
