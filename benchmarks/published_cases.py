"""Published output-error cases: time of our fit beside the published programs', and how near the results are.

    OPENBLAS_NUM_THREADS=1 python benchmarks/published_cases.py BOOK [CASE ...]

BOOK is the folder with the flight data of Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015 (doi
10.2514/4.102790), and with `references.json`, what its programs gave in GNU Octave. Cards and settings are those of
tests/cli/test_published_cases.py. `cold` compiles (nothing is kept on disk), `warm` is the same fit once more. Both are
of `fit_trajectories`: windows, whole manoeuvres, the residuals' colour and the simulations that are shown.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np
import scipy.io

from bayes_aero.diagnosis.result import Setting
from bayes_aero.diagnosis.trajectories import fit_trajectories
from bayes_aero.flight.card import channel_units, read_card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.fly import flown_dynamics

CASES = {
    "TC01": ("attas_lateral", ("fAttasAilRud1.asc",), "oem_gauss_newton"),
    "TC03": ("attas_roll_yaw", ("fAttasAilRud1.mat", "fAttasAilRud2.mat"), "oem_gauss_newton"),
    "TC04": ("hfb320", ("hfb320_1_10.asc",), "oem_gauss_newton"),
    "TC04 free": ("hfb320", ("hfb320_1_10.asc",), "oem_initial_state_free"),
    "TC08": ("unstable", ("unStabAC_sim.asc",), "oem_gauss_newton"),
    "TC11": ("attas_short_period", ("fAttasElv1.mat", "fAttasElv2.mat"), "oem_gauss_newton"),
}
OURS = {
    "Zal": "Zalpha", "Mal": "Malpha", "CDal": "CDa", "CLal": "CLa", "Cmal": "Cma", "bx_p": "L0", "bx_r": "N0",
    "by_pdot": "by_p_dot", "by_rdot": "by_r_dot", "by_p": "bias_p_1", "by_r": "bias_r_1",
}  # fmt: skip


def record_of(path: Path, card) -> FlightRecord:
    """A record; of a file with one matrix by its columns, the pause between two manoeuvres taken out of its time."""
    if path.suffix != ".mat":
        return read_record(path, card.channels)
    (table,) = (x for key, x in scipy.io.loadmat(path).items() if not key.startswith("_"))
    factors = {"deg": np.pi / 180.0, "deg/s": np.pi / 180.0, "deg/s^2": np.pi / 180.0}
    columns = {c.name: table[:, c.column - 1] * factors.get(c.unit, 1.0) for c in card.channels if c.name != "time"}
    return FlightRecord.from_arrays(path.stem, 0.04 * np.arange(len(table)), columns)


def fit(case: str, book: Path):
    """One fit with the published settings, and its wall time in s."""
    name, files, _ = CASES[case]
    card = read_card(name)
    records = [record_of(book / file, card) for file in files]
    flights, dynamics, _ = flown_dynamics(records, card, card.fly.outputs or (), path=False)
    initial = None if case.endswith("free") else card.fly.initial_state
    units = {key: channel.unit for key, channel in STANDARD_CHANNELS.items()} | channel_units(card)
    setting = Setting(card.fly.outputs, initial, priors=False, biases=card.output_biases)
    begin = time.perf_counter()
    found = fit_trajectories(flights, dynamics, units, setting=setting)
    return found.fit, time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("book", type=Path)
    parser.add_argument("cases", nargs="*", default=list(CASES), metavar="CASE")
    asked = parser.parse_args()
    jax.config.update("jax_enable_compilation_cache", False)
    references = json.loads((asked.book / "references.json").read_text(encoding="utf-8"))["cases"]
    print("| case | det R, ours over published | largest difference, std | cold, s | warm, s | theirs, s |")
    print("|---|---|---|---|---|---|")
    for case in asked.cases:
        theirs = references[case.split()[0]]["methods"][CASES[case][2]]
        found, cold = fit(case, asked.book)
        _, warm = fit(case, asked.book)
        ours = dict(zip(found.names, found.estimate, strict=True))
        apart = max(
            abs(ours[OURS.get(name, name)] - p["estimate"]) / p["std"]
            for name, p in theirs["parameters"].items()
            if p.get("std")
        )
        ratio, spent = found.det_R / theirs["det_R"], f"{theirs['wall_s']:.0f} (processor: {theirs['cpu_s']:.0f})"
        print(f"| {case} | {ratio:.5f} | {apart:.3f} | {cold:.1f} | {warm:.2f} | {spent} |", flush=True)


if __name__ == "__main__":
    main()
