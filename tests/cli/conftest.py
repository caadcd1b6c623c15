"""The program in this process, and one simulated record for all of its tests."""

import shutil
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from calling import called, recorded, succeeded

from bayes_aero.cli.app import main
from bayes_aero.jobs import diagnose as job


@pytest.fixture
def program(monkeypatch, capsys, tmp_path):
    """Call with arguments; gives code, out and err. The working directory is a fresh folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["bayes-aero", *map(str, arguments)])
        with pytest.raises(SystemExit) as stopped:
            main()
        code = stopped.value.code
        out, err = capsys.readouterr()
        return SimpleNamespace(code=0 if code is None else code, out=out, err=err)

    return call


@pytest.fixture(scope="session")
def flights(tmp_path_factory):
    """The same short stall, without noise, sound and with a gyro that is off by 0.3 deg/s."""
    folder = tmp_path_factory.mktemp("simulated")
    common = ["simulate", "--manoeuvre", "slow_stall", "--duration", "40", "--noise", "none", "--seed", "3"]
    paths = SimpleNamespace(folder=folder, sound=folder / "sound.csv", biased=folder / "biased.csv")
    for path, more in ((paths.sound, []), (paths.biased, ["--effect", "pitch_rate_bias=0.3 deg/s"])):
        assert called(folder, *common, *more, "--out", path).code == 0
    return paths


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


@pytest.fixture(scope="session")
def identified(tmp_path_factory, clean_records, card):
    """Two simulated stalls without noise as `stall.csv` and `other.csv`, and the `results` of identify on the first."""
    folder = tmp_path_factory.mktemp("identified")
    for record, name in zip(clean_records, ("stall", "other"), strict=True):
        recorded(record.window(25.0, 65.0), folder / f"{name}.csv", card)
    succeeded(called(folder, "identify", "stall.csv", "--out", "results", "--no-sample", "--no-gp", "--no-figures"))
    return folder


@pytest.fixture
def told_diagnosis(program, diagnosed, card, monkeypatch):
    """What `diagnose` says here of a diagnosis that is already made: test_every_stage.py has the command make one."""
    monkeypatch.setattr(job, "diagnose", lambda *_, **__: diagnosed.view.diagnosis)
    monkeypatch.setattr(job, "view_of", lambda _: diagnosed.view)
    recorded(diagnosed.records[0], Path("a.csv"), card)
    left_out = ("--no-figures", "--no-trajectories", "--no-test-points")
    return succeeded(program("diagnose", "a.csv", "--max-effects", "2", *left_out))
