"""The program: help, exit codes, interruptions, the catalogue, what is loaded; results of identify and diagnose."""

import json
import re
import subprocess
import sys
import time
from functools import reduce
from operator import getitem
from pathlib import Path
from types import SimpleNamespace
from typing import get_args
from unittest.mock import Mock

import numpy as np
import pytest
import six_axes as six
import stranger_six
from calling import answer, holds, page_of, succeeded, validated, validator
from markupsafe import escape

from bayes_aero.cli import app, main, terminal
from bayes_aero.cli.terminal import BAD_INPUT, DOUBT, FAILED, INTERRUPTED
from bayes_aero.diagnosis.result import WINDOW
from bayes_aero.effects import CATALOGUE
from bayes_aero.entry import _heed
from bayes_aero.flight import reading
from bayes_aero.inference.gp import SplitKind
from bayes_aero.jobs import identify as job
from bayes_aero.jobs import options
from bayes_aero.jobs.finished import FORMS
from bayes_aero.model.observations import Colour
from bayes_aero.model.records import Forming
from bayes_aero.processes import cache_folder

GONE = object()  # a key that is left out


def test_choices_are_those_of_the_libraries():
    assert get_args(options.FormingName) == tuple(x.value for x in Forming)
    assert get_args(options.NoiseName) == tuple(x.value for x in Colour)
    assert get_args(options.SplitName) == get_args(SplitKind)
    assert list(get_args(options.ExportForm)) == list(FORMS)
    assert options.FlyOptions().windows == WINDOW


def test_help_states_the_exit_codes_and_has_an_example_of_every_command(program):
    said = program("--help").out
    holds(said.split("Exit codes:")[1], *(f"{code} " for code in (FAILED, BAD_INPUT, DOUBT, INTERRUPTED)))
    for command in (registered.callback.__name__ for registered in app.registered_commands):
        assert f" {command} " in said
        holds(succeeded(program(command, "--help")).out, f"Example: bayes-aero {command} ")


def test_the_catalogue_is_listed_and_explained(program):
    effects = {e["name"]: e for e in answer(program("effects", "--json"))["effects"]}
    assert set(effects) == set(CATALOGUE)
    holds(program("effects").out, *CATALOGUE)
    explained = program("effects", "pitch_rate_bias").out
    holds(explained, "rad/s", "Klein and Morelli", "0.054", "normal 0 ± 0.01")
    assert effects["flow_separation"]["parameters"][0]["bounds"] == [1.0, 200.0]


def test_an_interruption_says_what_is_kept(program, monkeypatch):
    def interrupted(*_, out, **__):
        out.mkdir()
        (out / "parameters.csv").write_text("")
        raise KeyboardInterrupt

    monkeypatch.setattr(job, "identify", interrupted)
    holds(succeeded(program("identify"), INTERRUPTED).err, "parameters.csv", "same command")
    monkeypatch.setattr(reading, "read_records", Mock(side_effect=KeyboardInterrupt))
    assert "nothing had been written" in succeeded(program("identify", __file__), INTERRUPTED).err


@pytest.mark.usefixtures("interruptible")
def test_a_ctrl_c_that_a_library_drops_is_raised_again():
    """JAX hangs a callback on garbage collection; what is raised in it is printed and forgotten."""
    stop = {"exc_type": KeyboardInterrupt, "exc_value": KeyboardInterrupt()}
    dropped = SimpleNamespace(**stop, exc_traceback=None, err_msg=None, object=None)

    def callback():
        _heed(dropped)
        time.sleep(5.0)

    with pytest.raises(KeyboardInterrupt):
        callback()


def test_an_unexpected_failure_is_one_sentence_and_a_traceback_if_asked_for(program, monkeypatch, tmp_path):
    def broken(*_):
        raise ZeroDivisionError("no such luck")

    (tmp_path / "one.csv").write_text("t,V\n" + "\n".join(f"{0.1 * i},80" for i in range(60)))
    monkeypatch.setattr("bayes_aero.jobs.preparing.guessed", broken)
    said = succeeded(program("card", "one.csv"), 1).err
    assert said.startswith("error: the command failed unexpectedly (ZeroDivisionError: no such luck)")
    assert said.count("\n") == 1
    monkeypatch.setenv("BAYES_AERO_TRACEBACK", "1")
    monkeypatch.setattr(sys, "argv", ["bayes-aero", "card", "one.csv"])
    with pytest.raises(ZeroDivisionError):
        main()


def test_an_effect_on_the_aircraft_is_flown_by_a_program_of_its_own(tmp_path):
    """A process that has read no record flies an aircraft whose mass is a traced number."""
    asked = ("simulate", "--effect", "mass_scale=0.06", "--duration", "8", "--out", tmp_path / "m.csv")
    subprocess.run([sys.executable, "-m", "bayes_aero", *asked], capture_output=True, check=True)
    assert json.loads((tmp_path / "m.csv.truth.json").read_text())["parameters"]["mass_scale"] == 0.06


HEAVY = ("jax", "equinox", "numpyro", "arviz_base", "matplotlib", "pandas", "xarray", "scipy.stats", "scipy.signal")
LIGHT = {  # what is asked, and the exit code
    "--help": 0, "check flight.csv --model plane.toml": 0, "check flight.csv --model plane.toml --out checked": 0,
    "card flight.csv --out new.toml": 0, "check flight.csv --model nosuch": 2, "identify flight.csv --model attas": 2,
    "diagnose nosuch.csv": 2, "fly flight.csv --model attas": 2, "run study.toml": 2, "export nosuch --to jsbsim": 2,
    "open nosuch": 2,
}  # fmt: skip
LOADED = f"""
import json, sys
from bayes_aero.cli import main
for asked in {list(LIGHT)!r}:
    sys.argv = ["bayes-aero", *asked.split()]
    try:
        main()
    except SystemExit as stopped:
        any = ("numpy", "scipy", *{HEAVY!r})
        print(json.dumps([stopped.code or 0, [m for m in any if m in sys.modules]]), file=sys.stderr)
"""


def test_nothing_heavy_is_loaded(tmp_path):
    """On a record of another simulator, one command after the other in a process of their own."""
    rng, plane = np.random.default_rng(0), stranger_six.Plane(**six.ATTACHED)
    flight = six.recorded(stranger_six.fly(plane, "elevator", rng, seconds=16.0), rng)
    table = np.stack(list(flight.values()), axis=1)
    np.savetxt(tmp_path / "flight.csv", table, delimiter=",", header=",".join(flight), comments="")
    (tmp_path / "plane.toml").write_text(six.card_text(plane))
    (tmp_path / "study.toml").write_text("nonsense = 1")
    done = subprocess.run([sys.executable, "-c", LOADED], cwd=tmp_path, capture_output=True, text=True, check=False)
    reported = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("[")]
    assert [code for code, _ in reported] == list(LIGHT.values()), done.stderr
    assert reported[0][1] == []
    loaded = {asked: modules for asked, (_, modules) in zip(LIGHT, reported, strict=True)}
    assert {asked: modules for asked, modules in loaded.items() if not set(modules).isdisjoint(HEAVY)} == {}


def test_an_option_that_is_gone_says_what_to_use(program, monkeypatch):
    """Nothing else does: other commands and names of files are left alone."""
    for command, spelled, instead in terminal.GONE:
        for option in spelled.split("/"):
            for value in ("", "=x"):
                done = program(command, "no_such_file", option + value)
                assert (done.code, done.out) == (2, "")
                assert done.err == f"error: {option} of {command} is gone: {instead}\n"
            assert option not in program(command, "--help").out.split()
    monkeypatch.setattr(terminal, "GONE", (("check", "--old/--no-old", "leave it out"),))
    assert "--no-old of check is gone: leave it out" in program("check", "a.csv", "--no-old").err
    assert "gone" not in program("path", "a.csv", "--no-old").err
    assert "gone" not in program("check", "--", "--no-old").err


def test_results_follow_the_schema_and_are_told_alike_on_terminal_and_page(identified):
    """Nothing of an earlier run stands beside them; a channel in doubt and a sampler that did not end are told."""
    folder, content = identified.results, validated(identified.results / "results.json", "results")
    assert content["mle"]["status"] == "converged"
    assert set(content["posterior"]["emcee"]) >= {"alpha_star", "sigma_CL"}
    status = {engine: reached["status"] for engine, reached in content["posterior"]["status"].items()}
    assert status == {"emcee": "converged", "nuts": "not_converged"}
    assert content["next_flight"]["manoeuvres"] == list(content["mle"]["alone"]) == ["stall", "second"]
    assert all((folder / name).is_file() for name in ("parameters.csv", "posterior_nuts.nc", "next_flight.csv"))
    assert not [name for name in identified.older if (folder / name).exists()]
    assert {(folder / name).read_text() for name in identified.mine} == {"of another day"}
    assert not list(folder.glob("*.part"))
    doubt = [(h["channel"], h["fault"], h["grave"]) for h in content["health"]]
    assert doubt == [("altitude", "unit", True)]
    said, page = " ".join(identified.said.split()), page_of(folder)
    holds(said, "alpha_star", "! second: altitude is in ft", "Results are in results")
    assert "altitude is in ft" in page.split("<h2")[0]  # before all sections
    largest = content["stall"]["CL_max"]
    assert largest["ci95"][0] < largest["median"] < largest["ci95"][1]
    shown = [float(x) for x in re.findall(r"(\d\.\d{3,}) \(", page)]  # with as many digits as the interval needs
    assert any(x == pytest.approx(largest["median"], abs=5e-4) for x in shown)


def test_what_is_not_as_the_classes_say_is_refused(identified):
    text = (identified.results / "results.json").read_text()
    for place, value in (
        ("schema", "bayes_aero/results/0"), ("records", []), ("verdict", GONE), ("provenance seed", GONE),
        ("mle status", "perfect"), ("mle det_R", "small"), ("mle fit CL", GONE), ("mle fit lift", {}),
        ("stall at_edge", 1.5), ("stall CL_max ci95", [1.0]), ("health", None), ("next_flight more", 1),
        ("posterior emcee alpha_star rhat", GONE), ("consistency outcome", "maybe"), ("card name", 3),
    ):  # fmt: skip
        results = json.loads(text)
        *way, key = place.split()
        part = reduce(getitem, way, results)
        part.pop(key, None) if value is GONE else part.update({key: value})
        assert not validator("results").is_valid(results), place


@pytest.mark.verify
def test_same_seed_same_numbers(program, identified, monkeypatch):
    monkeypatch.setattr(job, "put_page", lambda *_: ())  # of which results.json has nothing
    asked = ("--noise", "white", "--no-gp", "--no-figures", "--next-flight", "--out")
    for out in ("first", "again"):
        succeeded(program("identify", *(identified.folder / f"{n}.csv" for n in ("stall", "other")), *asked, out))
    first, second = (json.loads(Path(out, "results.json").read_text()) for out in ("first", "again"))
    for content in (first, second):
        content.pop("provenance")
    assert first == second


def test_diagnose_writes_and_tells_what_it_found(tmp_path, diagnosis_output):
    content = validated(tmp_path / "diagnosis" / "diagnosis.json", "diagnosis")
    assert content["provenance"]["settings"] == {"max_effects": 2, "anyway": False}
    lacks = "The lateral axis (CY, Cl, Cn) is left out: record a has no channel ay"
    holds(" ".join(diagnosis_output.out.split()), lacks, *(cause["name"] for cause in content["causes"]))
    assert (tmp_path / "diagnosis" / "screen.csv").is_file()
    assert not (tmp_path / "diagnosis" / "figures").exists()
    holds(page_of(tmp_path / "diagnosis"), *(str(escape(cause["claim"])) for cause in content["causes"]))


def test_warm_compiles_what_the_demo_needs_and_says_where_it_is_kept(program, monkeypatch):
    ran = {name: Mock() for name in ("identify.identify", "diagnose.diagnose_records", "fly.fly")}
    for name, job_of in ran.items():
        monkeypatch.setattr(f"bayes_aero.jobs.{name}", job_of)
    done = succeeded(program("warm"))
    assert str(cache_folder()) in done.out
    for job_of in ran.values():
        assert [r.name for r in job_of.call_args.args[0]] == ["demo_stall_1", "demo_stall_2"]
