"""Print the gusts that the flight path shows, by which `fly` and `diagnose` decide on process noise.

    python benchmarks/gusts_shown.py [../shared]

Simulated flights in gusts by two simulators that share no code with the package, ATTAS-like stalls with one error of a
sensor each, and the real flights of the folder, where it is there.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from gusty_flight import gusty_flight
from stranger_records import Recorder, flown

from bayes_aero.diagnosis.consistency.consistency import consistency
from bayes_aero.diagnosis.consistency.sensor_errors import SENSOR_KINDS
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.simulate.injection import hidden_records


def shown(records, card) -> list[float]:
    """Of each record, m/s."""
    return [check.gusts for check in consistency(records, card, seek=False).recorded]


def strangers(gusts: float) -> list[float]:
    """Two stalls each of three aircraft drawn at random."""
    found = []
    for seed in (701, 702, 703):
        with tempfile.TemporaryDirectory() as folder:
            *_, files = flown(Path(folder), np.random.default_rng([seed, 12]), None, gusts, Recorder(), 2)
            card = read_card(str(Path(folder) / "card.toml"))
            found += shown([read_record(path, card.channels) for path in files], card)
    return found


def told(name: str, found: list[float]) -> None:
    """A line."""
    print(f"{name:45s} {min(found):.2f} to {max(found):.2f} m/s", flush=True)


def main() -> None:
    """All of them."""
    data, attas, hfb = Path(sys.argv[1] if len(sys.argv) > 1 else "../shared"), read_card("attas"), read_card("hfb320")
    for size in (0.0, 0.15, 0.3, 0.5, 1.0):
        flights = [gusty_flight(seed, gust={"w": size, "u": size}) for seed in (1, 2)]
        told(f"HFB-320, gusts of {size:g} m/s", [x for flight in flights for x in shown([flight], hfb)])
    for size in (0.0, 0.3, 0.5, 1.0):
        told(f"aircraft drawn at random, {size:g} m/s", strangers(size))
    for effect in (e for e in CATALOGUE.values() if e.kind in SENSOR_KINDS and e.disturbance is None):
        parameter = effect.parameters[0]
        size = parameter.neutral + parameter.prior.scale
        try:
            told(f"calm, {effect.name}", shown(hidden_records({effect.name: {parameter.name: size}}, seed=5), attas))
        except InputError as reason:
            print(f"{effect.name}: {reason}")
    for card, paths in ((hfb, ["book/hfb320_1_10.asc"]), (attas, [f"attas/fAttas_qst0{i}.asc" for i in (1, 2)])):
        for path in (data / p for p in paths if (data / p).is_file()):
            told(path.stem, shown([read_record(path, card.channels)], card))


if __name__ == "__main__":
    main()
