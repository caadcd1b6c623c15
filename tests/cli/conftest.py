"""The program in this process, and one simulated record for all of its tests."""

import shutil
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from calling import called, recorded, succeeded
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, record_of, short_period_flight

from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.flight.health import HealthFinding
from bayes_aero.inference import pooled
from bayes_aero.inference.sampling import EnsembleLength, NutsLength, find_mode, sample_ensemble, sample_nuts
from bayes_aero.jobs import check, diagnose, identify
from bayes_aero.simulate.demo import simulate_stall


@pytest.fixture
def program(monkeypatch, tmp_path):
    """Call with arguments; gives code, out and err. The working directory is a fresh folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return partial(called, ".")


@pytest.fixture(scope="session")
def flights(tmp_path_factory):
    """The same short stall, without noise, sound and with a gyro that is off by 0.3 deg/s."""
    folder = tmp_path_factory.mktemp("simulated")
    asked, said = ("--manoeuvre", "slow_stall", "--duration", "40"), ""
    paths = {"sound": folder / "sound.csv", "biased": folder / "biased.csv"}
    for name, more in (("sound", ()), ("biased", ("--effect", "pitch_rate_bias=0.3 deg/s"))):
        still = ("--noise", "none", "--seed", "3", "--out", paths[name])
        done = succeeded(called(folder, "simulate", *asked, *more, *still))
        said += " ".join((done.out + done.err).split())
    return SimpleNamespace(folder=folder, asked=asked, said=said, **paths)


@pytest.fixture
def flights_here(tmp_path, flights):
    """A folder of one's own with both in `flights`."""
    (tmp_path / "flights").mkdir()
    for path in (flights.sound, flights.biased):
        shutil.copy(path, tmp_path / "flights")
    return tmp_path


@pytest.fixture
def interruptible():
    """Where tests run in the background, Ctrl-C is ignored, and what they start inherits that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


OLDER = ("posterior_white.nc", "gpr.nc", "validation.csv", "figures/forest.png")
MINE = ("posterior_mine.nc", "notes.txt", "figures/mine.png")


@pytest.fixture(scope="session")
def identified(tmp_path_factory, clean_records, card):
    """Three stalls without noise, and `results` of identify on two with what it `said`: one in `doubt`, few samples."""
    folder = tmp_path_factory.mktemp("identified")
    records = {"stall": clean_records[0], "other": clean_records[1]}
    records["second"] = simulate_stall(0, card=card, seed=7, sensor_noise=0.0, disturbance=0.0)
    for name, record in records.items():
        recorded(record.window(25.0, 65.0), folder / f"{name}.csv", card)
    (folder / "results" / "figures").mkdir(parents=True)
    for name in (*OLDER, *MINE):
        (folder / "results" / name).write_text("of another day")
    words = "altitude is in ft", "", "", "second: altitude is in ft"
    doubt = HealthFinding("second", "altitude", "unit", None, None, *words, grave=True)
    short = NutsLength(chains=1, warmup=100, max_blocks=1, metric=False)
    ensemble, nuts = partial(sample_ensemble, length=EnsembleLength(2, 100)), partial(sample_nuts, length=short)
    with (
        patch.object(identify, "posterior_plan", lambda noise: [("emcee", noise, ensemble), ("nuts", noise, nuts)]),
        patch.object(identify, "search_modes", lambda density, start, *_, **__: find_mode(density, start)),
        patch.object(pooled, "pool", partial(pooled.pool, length=short)),
        patch.object(check, "channel_health", lambda *_: (doubt,)),
    ):
        asked = ("--noise", "white", "--no-gp", "--no-figures", "--next-flight", "--resample", "0.08")
        done = succeeded(called(folder, "identify", "stall.csv", "second.csv", "--out", "results", *asked), 3)
    made = {"results": folder / "results", "said": done.out, "older": OLDER, "mine": MINE, "doubt": doubt}
    return SimpleNamespace(folder=folder, **made)


NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}
TOLERANCES = '\n[tolerances]\nalpha = "2 deg"\nq = "2 deg/s"\naz = "0.02 m/s^2"\nairspeed = "3 kt"\n'


@pytest.fixture(scope="session")
def short_period(tmp_path_factory):
    """Three flights of a linear short period with white `noise`, its card, and `flown`: the fit of the first two."""
    folder = tmp_path_factory.mktemp("short_period")
    (folder / "sp.toml").write_text(SHORT_PERIOD + TOLERANCES)
    begins = {"one": (0.04, 0.01), "two": (0.04, -0.02), "other": (0.0, 0.02)}
    for seed, (name, begin) in enumerate(begins.items(), 1):
        flight, rng = short_period_flight(SHORT_PERIOD_TRUTH, x0=begin), np.random.default_rng(seed)
        record = record_of(flight, noise=NOISE, rng=rng, name=name)
        recorded(record, folder / f"{name}.csv", read_card(folder / "sp.toml"))
    asked = ("--windows", "5", "--frequency", "0.1", "1.5", "--no-process-noise", "--out", "flown")
    done = succeeded(called(folder, "fly", "one.csv", "two.csv", "--model", "sp.toml", *asked))
    return SimpleNamespace(folder=folder, flown=folder / "flown", said=" ".join(done.out.split()), noise=NOISE)


@pytest.fixture
def diagnosis_output(program, diagnosed, monkeypatch):
    """What `diagnose` says of a diagnosis that is already made, by a card with a lateral axis that was not recorded."""
    monkeypatch.setattr(diagnose, "diagnose", lambda *_, **__: diagnosed.view.diagnosis)
    monkeypatch.setattr(diagnose, "view_of", lambda _: diagnosed.view)
    text = shipped_cards()["attas"].read_text().replace('"AYCG", unit', '"AYCG", required = false, unit')
    axes = 'axes = ["longitudinal", "lateral"]\neffects = ["sideslip_side_force",'
    Path("card.toml").write_text(text.replace("effects = [", axes))
    record = diagnosed.records[0]
    channels = {name: x for name, x in record.channels.items() if name != "ay"}
    recorded(replace(record, channels=channels), Path("a.csv"), read_card("card.toml"))
    left_out = ("--no-figures", "--no-trajectories", "--no-test-points")
    return succeeded(program("diagnose", "a.csv", "--model", "card.toml", "--max-effects", "2", *left_out))
