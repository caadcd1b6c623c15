"""Two short simulated stalls, and the result of fly on them."""

import asyncio
import json
import shutil
import threading
from functools import partial
from queue import Queue
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from calling import called, recorded

from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.explore.opened import Simulator, open_result
from bayes_aero.explore.page import ExplorePage, PageServer
from bayes_aero.flight.reading import read_record
from bayes_aero.model.observations import despiked, join
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.simulate.demo import simulate_stall


@pytest.fixture(scope="session")
def results(tmp_path_factory, card):
    """A folder with two records (seed 5, noise and disturbance as usual; the second is shorter), and `flown`."""
    there = tmp_path_factory.mktemp("explore")
    for number, (name, end) in enumerate({"stall": 62.0, "second": 52.0}.items()):
        recorded(simulate_stall(number, card=card, seed=5).window(30.0, end), there / f"{name}.csv", card)
    flown = called(there, "fly", "stall.csv", "second.csv", "--out", "flown", "--no-figures", "--no-process-noise")
    assert flown.code in (0, 3), flown.err
    return SimpleNamespace(folder=there, flown=there / "flown")


@pytest.fixture(scope="session")
def simulator(results):
    """Of the result of fly."""
    return Simulator(open_result(str(results.flown)))


@pytest.fixture(scope="session")
def packaged(results, card):
    """`fly(model, **changed)`: outputs (n,) of the first record by a model as the package simulates it from the state
    that `fly` fitted."""
    told = json.loads((results.flown / "trajectories.json").read_text())
    records = [read_record(results.folder / f"{name}.csv", card.channels) for name in ("stall", "second")]
    flights, _ = despiked(join(records, card, FLIGHT))

    def fly(model, **changed):
        dynamics = aircraft_dynamics(model, flights)
        whole = segments(flights, dynamics)
        fitted = {name: p["estimate"] for name, p in told["parameters"].items()} | changed
        states = told["initial_states"].values()
        away = [[state.get(name, {"departure": 0.0})["departure"] for name in dynamics.start] for state in states]
        theta = jnp.array([fitted.get(p.name, p.start) for p in dynamics.free])
        found = simulate(whole, theta, jnp.array(away))
        first = np.asarray(found.measured - found.residual)[0, : records[0].n]
        return dict(zip(whole.outputs, first.T, strict=True))

    return fly


@pytest.fixture(scope="module")
def served(results, tmp_path_factory):
    """The page of a copy of the result of fly, served by a thread: `url`, `port` and `folder`."""
    folder = tmp_path_factory.mktemp("served") / "flown"
    shutil.copytree(results.flown, folder)
    fill = partial(ExplorePage, Simulator(open_result(str(folder), None, [results.folder])))
    ready: Queue[PageServer] = Queue()

    def run():
        asyncio.set_event_loop(asyncio.new_event_loop())
        server = PageServer(fill)
        ready.put(server)
        server.serve()

    thread = threading.Thread(target=run)
    thread.start()
    server = ready.get(timeout=60)
    yield SimpleNamespace(url=server.url, port=server.port, folder=folder)
    server.loop.add_callback(server.loop.stop)
    thread.join(timeout=60)
    assert not thread.is_alive()
