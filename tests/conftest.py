"""Fixtures that several test folders share."""

import gc
import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typechecker  # before the package is imported

from bayes_aero.diagnosis.diagnose import diagnose, view_of
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.entry import SELDOM
from bayes_aero.flight.card import read_card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join, observe
from bayes_aero.model.records import Forming
from bayes_aero.processes import full_of_programs, give_back_memory
from bayes_aero.simulate.demo import simulate_stall
from bayes_aero.simulate.injection import hidden_records

gc.set_threshold(*SELDOM)  # as the program does
ATTAS = Path(__file__).resolve().parents[2] / "shared" / "attas"
BOOK = ATTAS.parent / "book"
TESTS = Path(__file__).parent
sys.path.append(str(TESTS.parent / "benchmarks"))  # after all that is installed: one of them is called `coverage`
NUMBER = itertools.count()  # of tests
FIRST = ("forgets", "test_docs", "diagnosis", "diagnosed", "cli", "cluster", "inference")  # not to be begun last


@pytest.hookimpl(tryfirst=True)  # xdist reads the groups in a hook of this name that would come before
def pytest_collection_modifyitems(items):
    """One worker does what shares fixtures and compiled programs: a folder, or all that needs the fixture `diagnosed`.

    Groups of most work come first, before them tests that forget compiled programs.
    """
    groups = {item: _group(item) for item in items}
    others = [name for name in dict.fromkeys(groups.values()) if name not in FIRST]
    order = {name: number for number, name in enumerate((*FIRST, *others))}
    items.sort(key=lambda item: order[groups[item]])
    for item, group in groups.items():
        item.add_marker(pytest.mark.xdist_group(group))


def _group(item) -> str:
    apart = [mark for mark in ("forgets", "cluster") if mark in item.keywords]
    apart += ["diagnosed"] if "diagnosed" in item.fixturenames else []
    return [*apart, item.path.relative_to(TESTS).parts[0].removesuffix(".py")][0]


def pytest_collection_finish():
    gc.freeze()  # what is imported stays


def pytest_runtest_setup(item):
    typechecker.begin(item)


def pytest_runtest_teardown(nextitem):  # noqa: ARG001
    """A worker that runs a third of the tests would compile more programs than Linux lets one process map."""
    if next(NUMBER) % 8 == 0 and full_of_programs():  # to count its mappings takes some 10 ms
        give_back_memory()


@pytest.fixture(scope="session")
def card():
    return read_card("attas")


@pytest.fixture(scope="session")
def model(card):
    return Model.from_card(card)


@pytest.fixture(scope="session")
def attas_paths():
    paths = [ATTAS / f"fAttas_qst0{i}.asc" for i in (1, 2)]
    if not all(path.is_file() for path in paths):
        pytest.skip(f"the ATTAS records are not in {ATTAS}; see the README for how to get them")
    return paths


@pytest.fixture(scope="session")
def book():
    """The results of the book's programs, by case."""
    path = BOOK / "references.json"
    if not path.is_file():
        pytest.skip(f"the data of the book and the published results are not in {BOOK}")
    return json.loads(path.read_text(encoding="utf-8"))["cases"]


@pytest.fixture(scope="session")
def attas(attas_paths, card, model):
    """Observations of both real manoeuvres, formed as published."""
    return observe([read_record(path, card.channels) for path in attas_paths], card, model, Forming.PUBLISHED)


@pytest.fixture(scope="session")
def clean_records(card):
    """Two simulated manoeuvres without sensor noise or disturbance."""
    return [simulate_stall(i, card=card, sensor_noise=0.0, disturbance=0.0) for i in range(2)]


@pytest.fixture(scope="session")
def clean(clean_records, card, model):
    """Observations of the clean simulated manoeuvres."""
    return observe(clean_records, card, model)


@pytest.fixture(scope="session")
def everything(card):
    """Flights that have every channel, none at rest or mere noise, for what asks which effects a record can show."""
    rng, time = np.random.default_rng(0), np.arange(200) * 0.04
    names = [name for name in STANDARD_CHANNELS if name != "time"]
    waves = {name: np.sin(rng.uniform(1.0, 4.0) * time + rng.uniform(0.0, 6.0)) for name in names}
    around = {"airspeed": 80.0, "density": 1.0, "thrust": 9e3, "az": -9.8, "mach": 0.3, "altitude": 5e3}
    channels = {name: around[name] + 0.02 * x if name in around else 0.14 * x for name, x in waves.items()}
    return join([FlightRecord.from_arrays("run", time, channels)], replace(card, sums={}, constants={}))


@pytest.fixture(scope="session")
def thinned(clean):
    """Every fourth sample of the clean manoeuvres, as if sampled at 6.25 Hz: signals for cheap replicates."""
    index = np.concatenate([np.flatnonzero(clean.manoeuvre == m)[::4] for m in range(2)])
    part = clean.subset(index)
    start = np.concatenate([[True], np.diff(part.manoeuvre) != 0])
    return part.restarted(start)


@pytest.fixture(scope="session")
def diagnosed(card):
    """One short simulated manoeuvre that hides a sensor error and a curved pitching moment, and its diagnosis."""
    hidden = {"pitch_rate_bias": {"pitch_rate_bias": 0.01}, "alpha_squared_moment": {"Cma2": -5.0}}
    records = hidden_records(hidden, seed=3, manoeuvres=1, seconds=60.0, noise="white")
    view = view_of(diagnose(records, card, settings=DiagnosisSettings(max_effects=2)))
    return SimpleNamespace(hidden=hidden, records=records, view=view)


@pytest.fixture(scope="module")
def browser():
    """A real browser; its loop of events must not outlive the module."""
    from browsing import CHROMIUM, playwright

    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()
