"""One short simulated stall, and the results of fly and identify on it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from calling import called

from bayes_aero.explore.opened import open_result
from bayes_aero.explore.simulator import Simulator
from bayes_aero.flight.reading.read_record import write_record
from bayes_aero.simulate.demo import simulate_stall

BARE = ("--no-figures", "--no-process-noise")


@pytest.fixture(scope="session")
def results(tmp_path_factory, card):
    """A folder with `stall.csv` (seed 5, noise and disturbance as usual) and the folders `flown` and `identified`."""
    there = tmp_path_factory.mktemp("explore")
    record = simulate_stall(0, card=card, seed=5).window(30.0, 62.0)
    write_record(record, there / "stall.csv", [c for c in card.channels if record.has(c.name) or c.name == "time"])
    for command, out, more in (("fly", "flown", BARE), ("identify", "identified", ("--no-sample", "--no-gp", BARE[0]))):
        done = called(there, command, "stall.csv", "--out", out, *more)
        assert done.code in (0, 3), done.err
    return SimpleNamespace(folder=there, flown=there / "flown", identified=there / "identified")


@pytest.fixture(scope="session")
def simulator(results):
    """Of the result of fly."""
    return Simulator(open_result(str(results.flown)))
