"""The program itself: help, exit codes, JSON, interruptions, the catalogue, what is loaded, options that are gone."""

import json
import signal
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import get_args
from unittest.mock import Mock

import numpy as np
import pytest
from calling import answer, holds, page_of, refused, succeeded

from bayes_aero.cli import app, terminal
from bayes_aero.cli.app import main
from bayes_aero.cli.terminal import BAD_INPUT, DOUBT, FAILED, INTERRUPTED
from bayes_aero.diagnosis.trajectories import WINDOW
from bayes_aero.effects import CATALOGUE
from bayes_aero.entry import _heed
from bayes_aero.flight import reading
from bayes_aero.flight.card import read_card
from bayes_aero.inference.validation import SplitKind
from bayes_aero.jobs import identify as job
from bayes_aero.jobs import options
from bayes_aero.model.noise import Colour
from bayes_aero.model.observations import Forming
from bayes_aero.simulate import demo
from bayes_aero.study import study

COMMANDS = sorted(command.callback.__name__ for command in app.registered_commands)
OWN = """
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior

EFFECT = Effect(
    name="my_moment", kind=Kind.AERODYNAMICS, stage=Stage.TOTAL, claim="Mine.",
    parameters=(Parameter("Cmy", "1", 0.0, 0.0, "mine", Prior("normal", 0.0, 1.0)),),
    channels=("alpha",), increments=lambda v, s, a, known: {"Cm": v["Cmy"] * s["alpha"]},
    example=Example({"Cmy": 1.0}, {"alpha": 0.1}, {"Cm": 0.1}, "by hand"), source="mine",
)
"""


def test_choices_are_those_of_the_libraries():
    assert get_args(options.FormingName) == tuple(x.value for x in Forming)
    assert get_args(options.NoiseName) == tuple(x.value for x in Colour)
    assert get_args(options.SplitName) == get_args(SplitKind)
    assert get_args(options.Manoeuvre) == demo.MANOEUVRES
    assert get_args(options.SimulatedNoise) == demo.NOISES
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


def test_help_waits_for_no_numerical_library():
    told = "import sys, bayes_aero.cli; print([m for m in ('jax', 'numpy', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_the_module_is_the_program(monkeypatch, capsys):
    import runpy

    monkeypatch.setattr(sys, "argv", ["bayes-aero", "--version"])
    with pytest.raises(SystemExit):
        runpy.run_module("bayes_aero", run_name="__main__")
    assert "bayes-aero" in capsys.readouterr().out


def test_the_catalogue_is_listed_and_explained(program):
    listed = program("effects").out
    found = {e["name"]: e for e in answer(program("effects", "--json"))["effects"]}
    assert set(found) == set(CATALOGUE)
    assert all(name in listed for name in CATALOGUE)
    told = program("effects", "pitch_rate_bias").out
    holds(told, "rad/s", "Klein and Morelli", "0.054", "normal, mean 0, deviation 0.01")
    assert found["flow_separation"]["parameters"][0]["bounds"] == [1.0, 200.0]


def test_the_catalogue_is_a_page_too(program, tmp_path):
    succeeded(program("effects", "--model", "attas", "--out", "all"))
    assert json.loads((tmp_path / "all" / "effects.json").read_text())["effects"][0]["name"] in CATALOGUE
    html = page_of(tmp_path / "all")
    assert all(f"<summary>{name}</summary>" in html for name in CATALOGUE)
    assert "Klein and Morelli" in html
    assert html.count("in the card&#39;s model</td>") == len(read_card("attas").effects)
    needing = sum("thrust" in effect.channels for effect in CATALOGUE.values())
    alt = html.split('alt="')[1].split('"')[0]
    assert f"thrust by {needing}" in alt
    assert (tmp_path / "all" / "figures" / "channels.png").stat().st_size > 5000
    assert program("effects", "pitch_rate_bias", "--out", "one", "--json").code == 0
    one = page_of(tmp_path / "one")
    assert "Effect: pitch_rate_bias" in one
    assert "flow_separation" not in one


def test_effects_of_a_card_are_listed_with_it_and_an_unknown_one_with_its_neighbours(program, tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    text = study.shipped_cards()["attas"].read_text()
    (tmp_path / "mine.toml").write_text(text.replace("[model]\n", '[model]\neffect_files = ["mine.py"]\n'))
    found = answer(program("effects", "my_moment", "--model", "mine.toml", "--json"))["effects"]
    assert found[0]["claim"] == "Mine."
    assert found[0]["model"] is False
    assert program("effects", "my_moment").code == 2
    refused(program("effects", "pitch_rat_bias"), "pitch_rate_bias")


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


def test_json_is_all_that_is_on_stdout(program, monkeypatch):
    def finished(*_, out, **__):
        out.mkdir()
        (out / "results.json").write_text('{"schema": "bayes_aero/results/1"}\n')
        return SimpleNamespace(consistency=None, health=(), failures=())

    monkeypatch.setattr(job, "identify", finished)
    assert answer(program("identify", "--json")) == {"schema": "bayes_aero/results/1"}


def test_a_ctrl_c_that_a_library_drops_is_raised_again():
    """JAX hangs a callback on garbage collection; what is raised in it is printed and forgotten."""
    stop = {"exc_type": KeyboardInterrupt, "exc_value": KeyboardInterrupt()}
    dropped = SimpleNamespace(**stop, exc_traceback=None, err_msg=None, object=None)

    def callback():
        _heed(dropped)
        time.sleep(5.0)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background
    try:
        with pytest.raises(KeyboardInterrupt):
            callback()
    finally:
        signal.signal(signal.SIGINT, before)


def test_nothing_of_an_earlier_run_stands_beside_a_later_one(program, flights, tmp_path):
    """A posterior of other settings beside new estimates would be read as theirs; the user's own files stay."""
    out = tmp_path / "id"
    (out / "figures").mkdir(parents=True)
    older = [out / name for name in ("posterior_nuts.nc", "gpr.nc", "validation.csv", "figures/forest.png")]
    mine = [out / name for name in ("posterior_mine.nc", "notes.txt", "figures/mine.png")]
    for path in (*older, *mine):
        path.write_text("of another day")
    succeeded(program("identify", flights.sound, "--no-sample", "--no-gp", "--no-figures", "--out", "id"))
    assert not any(path.exists() for path in older)
    assert all(path.read_text() == "of another day" for path in mine)
    assert (out / "report.html").exists()


def test_an_unexpected_failure_is_one_sentence_and_a_traceback_if_asked_for(program, monkeypatch, tmp_path):
    def broken(*_):
        raise ZeroDivisionError("no such luck")

    (tmp_path / "one.csv").write_text("t,V\n" + "\n".join(f"{0.1 * i},80" for i in range(60)))
    monkeypatch.setattr("bayes_aero.jobs.card_template.guessed", broken)
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
    given = [
        "simulate",
        "--effect",
        "mass_scale=0.06",
        "--duration",
        "8",
        "--no-page",
        "--out",
        str(tmp_path / "m.csv"),
    ]
    done = subprocess.run([sys.executable, "-m", "bayes_aero", *given], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    truth = json.loads((tmp_path / "m.csv.truth.json").read_text())
    assert truth["parameters"]["mass_scale"] == 0.06


HEAVY = ("jax", "equinox", "numpyro", "arviz_base", "matplotlib", "pandas", "xarray", "scipy.stats", "scipy.signal")
LOADED = f"""
import json, sys
from bayes_aero.cli import main
try:
    main()
except SystemExit as stopped:
    print(json.dumps([stopped.code or 0, [m for m in {HEAVY!r} if m in sys.modules]]), file=sys.stderr)
"""
GLIDER = """
title = "a glider"
[aircraft]
mass = "500 kg"
Ix = "1500 kg m^2"
Iy = "1000 kg m^2"
Iz = "2500 kg m^2"
Ixz = "0 kg m^2"
wing_area = "11 m^2"
chord = "0.75 m"
half_span = "7.5 m"
aspect_ratio = 20.0
tail_arm = "4 m"
[channels]
time = { label = "t", unit = "s" }
ax = { label = "ax", unit = "m/s^2" }
az = { label = "az", unit = "m/s^2" }
q = { label = "q", unit = "rad/s" }
theta = { label = "theta", unit = "rad" }
alpha = { label = "alpha", unit = "rad" }
airspeed = { label = "V", unit = "m/s" }
[constants]
density = "1 kg/m^3"
thrust = "0 N"
p = "0 rad/s"
r = "0 rad/s"
[model]
effects = ["attached_lift", "profile_drag"]
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A steady climb with noise, and its card."""
    folder = tmp_path_factory.mktemp("light")
    rng, n = np.random.default_rng(0), 400
    steady = {"ax": 9.80665 * np.sin(0.1), "az": -9.80665 * np.cos(0.1), "q": 0.0, "theta": 0.1, "alpha": 0.05, "V": 30}
    noise = {"ax": 0.01, "az": 0.02, "q": 1e-4, "theta": 1e-3, "alpha": 1e-3, "V": 0.1}
    columns = [0.1 * np.arange(n), *(x + noise[name] * rng.standard_normal(n) for name, x in steady.items())]
    header = ",".join(["t", *steady])
    np.savetxt(folder / "climb.csv", np.stack(columns, axis=1), delimiter=",", header=header, comments="")
    (folder / "glider.toml").write_text(GLIDER)
    (folder / "study.toml").write_text("nonsense = 1")
    return folder


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        (0, ["check", "climb.csv", "--model", "glider.toml"]),
        (0, ["check", "climb.csv", "--model", "glider.toml", "--out", "checked"]),
        (0, ["card", "climb.csv", "--out", "new.toml"]), (2, ["check", "climb.csv", "--model", "nosuch"]),
        (2, ["identify", "climb.csv", "--model", "attas"]), (2, ["diagnose", "nosuch.csv"]),
        (2, ["fly", "climb.csv", "--model", "attas"]), (2, ["run", "study.toml"]),
        (2, ["export", "nosuch", "--to", "jsbsim"]), (2, ["open", "nosuch"]),
    ],
)  # fmt: skip
def test_nothing_heavy_is_loaded(files, code, arguments):
    command = [sys.executable, "-c", LOADED, *arguments]
    done = subprocess.run(command, cwd=files, capture_output=True, text=True, check=False)
    found = json.loads(done.stderr.splitlines()[-1])
    assert found == [code, []], done.stderr


SPELLED = [(command, given, instead) for command, option, instead in terminal.GONE for given in option.split("/")]


@pytest.mark.parametrize(("command", "option", "instead"), SPELLED)
@pytest.mark.parametrize("value", ["", "=x"])
def test_an_option_that_is_gone_says_what_to_use(program, command, option, instead, value):
    done = program(command, "no_such_file", option + value)
    assert (done.code, done.out) == (2, "")
    assert done.err == f"error: {option} of {command} is gone: {instead}\n"


@pytest.mark.parametrize(("command", "option"), [row[:2] for row in SPELLED])
def test_no_command_has_an_option_that_is_gone(program, command, option):
    assert option not in program(command, "--help").out.split()


def test_other_commands_and_names_of_files_are_left_alone(program, monkeypatch):
    monkeypatch.setattr(terminal, "GONE", (("check", "--old/--no-old", "leave it out"),))
    assert "--no-old of check is gone: leave it out" in program("check", "a.csv", "--no-old").err
    assert "gone" not in program("path", "a.csv", "--no-old").err
    assert "gone" not in program("check", "--", "--no-old").err
