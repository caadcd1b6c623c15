"""The faulty records of `../shared/records`: `check` and `identify` must report each, and nothing on sound ones.

`make.py` there writes the records, and `run.py` has the tables and says what counts as told. They are read here, and
the program is called in this process: forty processes would each load and compile it.
"""

from __future__ import annotations

import ast
import re
import runpy
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from calling import called

import bayes_aero as ba
from bayes_aero.diagnosis.consistency import consistency
from bayes_aero.diagnosis.consistency.sensor_errors import screen_sensor_errors
from bayes_aero.errors import InputError
from bayes_aero.jobs import check
from bayes_aero.jobs import identify as job
from bayes_aero.jobs.card.card_template import starter_card

SHARED = Path(__file__).resolve().parents[3] / "shared" / "records"
QUICK = ("--no-sample", "--no-gp", "--no-figures")
REFUSED = ("several_rates_blank", "several_rates_nan", "unit_row_as_avionics_spell")  # the others are read


def judge():
    """`WRONG`, `SOUND`, `FILES` and `told` of run.py, without running it."""
    if not (SHARED / "run.py").is_file():
        return {"WRONG": {}, "SOUND": [], "FILES": {}, "told": None}
    tree = ast.parse((SHARED / "run.py").read_text())
    tree.body = [
        node
        for node in tree.body
        if (isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in ("WRONG", "SOUND", "FILES"))
        or (isinstance(node, ast.FunctionDef) and node.name == "told")
    ]
    found = {"re": re}
    exec(compile(tree, "run.py", "exec"), found)
    return found


JUDGE = judge()


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """The records: what make.py asks the program for is done in this process."""
    if not JUDGE["WRONG"]:
        pytest.skip(f"the faulty records are not in {SHARED}")
    root = tmp_path_factory.mktemp("faulty_records")

    def simulated(command, **_):
        done = called(root, *command[1:])
        assert (command[0], done.code) == ("bayes-aero", 0), done.err

    with (
        patch.object(sys, "argv", ["make.py", str(root)]),
        patch.object(subprocess, "run", simulated),
        warnings.catch_warnings(action="ignore"),  # what it has pandas do is no matter of the program's
    ):
        runpy.run_path(str(SHARED / "make.py"))
    assert (root / "files" / "matrix.mat").is_file()
    return root


@pytest.fixture
def bare(monkeypatch):
    """`identify` without its page and the simulation on it: faults are reported before those are made.

    Both commands search the same records for errors of sensors: that is done once.
    """
    found = {}

    def once(records, card, *, seed=0):
        key = (*((record.sha256, record.n) for record in records), seed)
        if key not in found:
            found[key] = screen_sensor_errors(records, card, seed=seed)
        return found[key]

    monkeypatch.setattr(check, "screen_sensor_errors", once)
    monkeypatch.setattr(consistency, "screen_sensor_errors", once)
    monkeypatch.setattr(job, "put_page", lambda *_: ())
    monkeypatch.setattr(job, "fly_identified", lambda *_: ((), (), ()))


@pytest.fixture
def call(program, made, tmp_path):
    """`run.py`'s own: copies under names that give nothing away."""

    def called(*words):
        given, number = [], 0
        for word in words:
            path = made / word
            if path.is_file() and not word.startswith("-"):
                number += path.suffix != ".toml"
                name = "c.toml" if path.suffix == ".toml" else f"r{number}{path.suffix}"
                shutil.copy(path, tmp_path / name)
                given.append(f"./{name}")
            else:
                given.append(word)
        done = program(*given)
        return done.code, done.out + done.err

    return called


@pytest.mark.usefixtures("bare")
@pytest.mark.parametrize("records", JUDGE["SOUND"], ids=" ".join)
def test_sound_records_pass(call, records):
    code, said = call("check", *records)
    fit, told = call("identify", *records, *QUICK, "--out", "sound")
    assert (code, fit) == (0, 0)
    assert "disagree" not in said + told
    assert "✗" not in said + told


@pytest.mark.usefixtures("bare")
@pytest.mark.parametrize("records", JUDGE["WRONG"], ids=" ".join)
def test_wrong_contents_are_told(call, records):
    options, words = JUDGE["WRONG"][records]
    for command, more in (("check", ()), ("identify", (*QUICK, "--out", "wrong"))):
        code, said = call(command, *records, *options, *more)
        assert JUDGE["told"](code, said, words), (command, code, said)


@pytest.mark.parametrize("name", JUDGE["FILES"])
def test_files_are_read_right_or_refused_in_words(made, name):
    """`run.py` fits each file: one whose channels are those of the base record has its estimates."""
    base = ba.read(made / "base.csv")[0]
    if Path(name).stem in REFUSED:
        with pytest.raises(InputError) as refused:
            ba.read(made / name)
        assert any(word in str(refused.value) for word in JUDGE["FILES"][name])
    else:
        same(ba.read(made / name)[0], base)


@pytest.mark.parametrize("name", ["several_rates_blank", "several_rates_nan"])
def test_several_rates_are_interpolated(made, name):
    base = ba.read(made / "base.csv")[0]
    found = ba.read(made / f"files/{name}.csv", resample=0.04)[0]
    assert found.n == base.n
    for channel, noise in (("airspeed", 0.5), ("altitude", 2.0), ("density", 5e-3)):
        assert np.std(found[channel] - base[channel]) < noise  # of the simulated sensors


def same(found, base) -> None:
    """To the digits of the file; time from the first sample."""
    np.testing.assert_allclose(found.time - found.time[0], base.time - base.time[0], atol=1e-6)
    assert set(found.names) == set(base.names)
    for channel, values in base.channels.items():
        whole = 0.5 if channel in ("altitude", "thrust_left", "thrust_right") else 0.0
        np.testing.assert_allclose(found[channel], values, rtol=1e-5, atol=whole + 1e-8 + 1e-6 * np.ptp(values))


@pytest.mark.parametrize(
    ("name", "channels"),
    [
        ("pipes.txt", {"time", "alpha", "theta", "phi", "q", "az", "ax", "airspeed", "elevator", "altitude"}),
        ("two_header_rows.csv", {"time", "ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta"}),
        ("struct73.mat", {"time", "ax", "az", "q", "alpha", "airspeed", "elevator", "density", "mach"}),
    ],
)
def test_card_finds_the_columns(made, name, channels):
    assert channels <= set(starter_card(made / "files" / name).found)
