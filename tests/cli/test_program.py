"""The program: help, exit codes, interruptions, the catalogue, what is loaded; results of identify and diagnose."""

import json
import re
import subprocess
import sys
import time
from functools import reduce
from types import SimpleNamespace
from typing import get_args
from unittest.mock import Mock, patch

import jsonschema
import numpy as np
import pytest
import six_axes as six
import stranger_six
from calling import answer, called, holds, page_of, recorded, succeeded, validated
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
from bayes_aero.jobs.documents import document_schema
from bayes_aero.jobs.finished import FORMS
from bayes_aero.model.observations import Colour
from bayes_aero.model.records import Forming

COMMANDS = sorted(command.callback.__name__ for command in app.registered_commands)


def test_choices_are_those_of_the_libraries():
    assert get_args(options.FormingName) == tuple(x.value for x in Forming)
    assert get_args(options.NoiseName) == tuple(x.value for x in Colour)
    assert get_args(options.SplitName) == get_args(SplitKind)
    assert list(get_args(options.ExportForm)) == list(FORMS)
    assert options.FlyOptions().windows == WINDOW


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_has_an_example(program, command):
    done = succeeded(program(command, "--help"))
    assert f"Example: bayes-aero {command} " in done.out


def test_help_states_the_exit_codes(program):
    done = program("--help")
    for code in (FAILED, BAD_INPUT, DOUBT, INTERRUPTED):
        assert f"{code} " in done.out.split("Exit codes:")[1]
    for command in COMMANDS:
        assert f" {command} " in done.out


def test_the_catalogue_is_listed_and_explained(program):
    listed = program("effects").out
    found = {e["name"]: e for e in answer(program("effects", "--json"))["effects"]}
    assert set(found) == set(CATALOGUE)
    assert all(name in listed for name in CATALOGUE)
    told = program("effects", "pitch_rate_bias").out
    holds(told, "rad/s", "Klein and Morelli", "0.054", "normal, mean 0, deviation 0.01")
    assert found["flow_separation"]["parameters"][0]["bounds"] == [1.0, 200.0]


def test_an_interruption_says_what_is_kept(program, monkeypatch, flights):
    def interrupted(*_, out, **__):
        out.mkdir()
        (out / "parameters.csv").write_text("")
        raise KeyboardInterrupt

    monkeypatch.setattr(job, "identify", interrupted)
    done = program("identify")
    assert done.code == INTERRUPTED
    assert all(part in done.err for part in ("parameters.csv", "same command"))
    monkeypatch.setattr(reading, "read_records", Mock(side_effect=KeyboardInterrupt))
    done = program("identify", flights.sound)
    assert done.code == INTERRUPTED
    assert "nothing had been written" in done.err


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


def test_nothing_of_an_earlier_run_stands_beside_a_later_one_and_json_is_all_on_stdout(program, flights, tmp_path):
    """A posterior of other settings beside new estimates would be read as theirs; the user's own files stay."""
    out = tmp_path / "id"
    (out / "figures").mkdir(parents=True)
    older = [out / name for name in ("posterior_nuts.nc", "gpr.nc", "validation.csv", "figures/forest.png")]
    mine = [out / name for name in ("posterior_mine.nc", "notes.txt", "figures/mine.png")]
    for path in (*older, *mine):
        path.write_text("of another day")
    quick = ("--no-sample", "--no-gp", "--no-figures")
    told = answer(program("identify", flights.sound, *quick, "--out", "id", "--json"))
    assert told == json.loads((out / "results.json").read_text())
    assert not any(path.exists() for path in older)
    assert all(path.read_text() == "of another day" for path in mine)
    assert (out / "report.html").exists()


def test_an_unexpected_failure_is_one_sentence_and_a_traceback_if_asked_for(program, monkeypatch, tmp_path):
    def broken(*_):
        raise ZeroDivisionError("no such luck")

    (tmp_path / "one.csv").write_text("t,V\n" + "\n".join(f"{0.1 * i},80" for i in range(60)))
    monkeypatch.setattr("bayes_aero.jobs.preparing.guessed", broken)
    done = program("card", "one.csv")
    assert done.code == 1
    assert done.err.startswith("error: the command failed unexpectedly (ZeroDivisionError: no such luck)")
    assert done.err.count("\n") == 1
    monkeypatch.setenv("BAYES_AERO_TRACEBACK", "1")
    monkeypatch.setattr(sys, "argv", ["bayes-aero", "card", "one.csv"])
    with pytest.raises(ZeroDivisionError):
        main()


def test_an_effect_on_the_aircraft_is_flown_by_a_program_of_its_own(tmp_path):
    """A process that has read no record flies an aircraft whose mass is a traced number."""
    given = ("simulate", "--effect", "mass_scale=0.06", "--duration", "8", "--out", tmp_path / "m.csv")
    done = subprocess.run([sys.executable, "-m", "bayes_aero", *given], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    truth = json.loads((tmp_path / "m.csv.truth.json").read_text())
    assert truth["parameters"]["mass_scale"] == 0.06


HEAVY = ("jax", "equinox", "numpyro", "arviz_base", "matplotlib", "pandas", "xarray", "scipy.stats", "scipy.signal")
ANY = ("numpy", "scipy", *HEAVY)
LOADED = f"""
import json, sys
from bayes_aero.cli import main
try:
    main()
except SystemExit as stopped:
    print(json.dumps([stopped.code or 0, [m for m in {ANY!r} if m in sys.modules]]), file=sys.stderr)
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A record of another simulator, and its card."""
    folder, rng = tmp_path_factory.mktemp("light"), np.random.default_rng(0)
    plane = stranger_six.Plane(**six.ATTACHED)
    flight = six.recorded(stranger_six.fly(plane, "elevator", rng, seconds=16.0), rng)
    table = np.stack(list(flight.values()), axis=1)
    np.savetxt(folder / "flight.csv", table, delimiter=",", header=",".join(flight), comments="")
    (folder / "plane.toml").write_text(six.card_text(plane))
    (folder / "study.toml").write_text("nonsense = 1")
    return folder


@pytest.mark.parametrize(("code", "arguments"), [
    (0, "--help"), (0, "check flight.csv --model plane.toml"),
    (0, "check flight.csv --model plane.toml --out checked"), (0, "card flight.csv --out new.toml"),
    (2, "check flight.csv --model nosuch"), (2, "identify flight.csv --model attas"), (2, "diagnose nosuch.csv"),
    (2, "fly flight.csv --model attas"), (2, "run study.toml"), (2, "export nosuch --to jsbsim"),
    (2, "open nosuch"),
])  # fmt: skip
def test_nothing_heavy_is_loaded(files, code, arguments):
    command = [sys.executable, "-c", LOADED, *arguments.split()]
    done = subprocess.run(command, cwd=files, capture_output=True, text=True, check=False)
    found, loaded = json.loads(done.stderr.splitlines()[-1])
    assert found == code
    assert set(loaded).isdisjoint(ANY if arguments == "--help" else HEAVY), done.stderr


SPELLED = [(command, given, instead) for command, option, instead in terminal.GONE for given in option.split("/")]


@pytest.mark.parametrize(("command", "option", "instead"), SPELLED)
@pytest.mark.parametrize("value", ["", "=x"])
def test_an_option_that_is_gone_says_what_to_use(program, command, option, instead, value):
    done = program(command, "no_such_file", option + value)
    assert (done.code, done.out) == (2, "")
    assert done.err == f"error: {option} of {command} is gone: {instead}\n"
    assert option not in program(command, "--help").out.split()


def test_other_commands_and_names_of_files_are_left_alone(program, monkeypatch):
    monkeypatch.setattr(terminal, "GONE", (("check", "--old/--no-old", "leave it out"),))
    assert "--no-old of check is gone: leave it out" in program("check", "a.csv", "--no-old").err
    assert "gone" not in program("path", "a.csv", "--no-old").err
    assert "gone" not in program("check", "--", "--no-old").err


SETTINGS = ("--noise", "white", "--no-gp", "--no-figures", "--next-flight")
GONE = object()  # a key that is left out


@pytest.fixture(scope="module")
def flown(tmp_path_factory, clean_records, card):
    """The stalls of both simulated manoeuvres as CSV files, and the results of one run on them."""
    folder = tmp_path_factory.mktemp("flown")
    paths = []
    for record in (whole.window(25.0, 65.0) for whole in clean_records):
        paths.append(folder / f"{record.name}.csv")
        recorded(record, paths[-1], card)
    done = succeeded(called(folder, "identify", *paths, "--out", "first", *SETTINGS))
    return folder, paths, done


def test_results_follow_the_schema_and_are_told_alike_on_terminal_and_page(flown):
    folder, _, done = flown
    results = validated(folder / "first" / "results.json", "results")
    assert results["mle"]["status"] == "converged"
    assert set(results["posterior"]["emcee"]) >= {"alpha_star", "sigma_CL"}
    assert len(results["provenance"]["inputs"]) == 2
    assert results["next_flight"]["manoeuvres"] == list(results["mle"]["alone"])
    for name in ("parameters.csv", "posterior_nuts.nc", "next_flight.csv", "next_flight.nc"):
        assert (folder / "first" / name).is_file()
    holds(done.out, "alpha_star", "first")
    assert results["notes"] == []
    stall = results["stall"]
    assert stall["CL_max"]["ci95"][0] < stall["CL_max"]["median"] < stall["CL_max"]["ci95"][1]
    page = page_of(folder / "first")
    told = [float(x) for x in re.findall(r"(\d\.\d{3,}) \(", page)]  # with as many digits as the interval needs
    assert any(x == pytest.approx(stall["CL_max"]["median"], abs=5e-4) for x in told)
    assert not list((folder / "first").glob("*.part"))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("schema", "bayes_aero/results/0"), ("records", []), ("verdict", GONE), ("provenance seed", GONE),
        ("mle status", "perfect"), ("mle det_R", "small"), ("mle fit CL", GONE), ("mle fit lift", {}),
        ("stall at_edge", 1.5), ("stall CL_max ci95", [1.0]), ("health", None), ("next_flight more", 1),
        ("posterior emcee alpha_star rhat", GONE), ("consistency outcome", "maybe"), ("card name", 3),
    ],
)  # fmt: skip
def test_what_is_not_as_the_classes_say_is_refused(flown, place, value):
    results = json.loads((flown[0] / "first" / "results.json").read_text())
    *way, key = place.split()
    part = reduce(lambda whole, name: whole[name], way, results)
    part.pop(key, None) if value is GONE else part.update({key: value})
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(results, document_schema("results"))


@pytest.mark.verify
def test_same_seed_same_numbers(flown):
    folder, paths, _ = flown
    with patch.object(job, "put_page", lambda *_: ()):  # of which results.json has nothing
        again = called(folder, "identify", *paths, "--out", "again", *SETTINGS)
    assert again.code == 0, again.err
    first, second = (json.loads((folder / out / "results.json").read_text()) for out in ("first", "again"))
    first.pop("provenance")
    second.pop("provenance")
    assert first == second


def test_diagnose_writes_and_tells_what_it_found(tmp_path, told_diagnosis):
    found = validated(tmp_path / "diagnosis" / "diagnosis.json", "diagnosis")
    assert found["provenance"]["settings"] == {"max_effects": 2}
    for cause in found["causes"]:
        assert cause["name"] in told_diagnosis.out
    assert (tmp_path / "diagnosis" / "screen.csv").is_file()
    assert not (tmp_path / "diagnosis" / "figures").exists()
    page = page_of(tmp_path / "diagnosis")
    assert all(str(escape(cause["claim"])) in page for cause in found["causes"])
