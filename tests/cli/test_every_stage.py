"""Every command on records of some seconds, with every shipped card, and with channels and entries of a card left out:
it ends in a sentence, and the page says what could not be done.

A few are fixed. `make verify` draws three at random, other ones each time, and says their seed; with `FUZZ=20` in the
environment twenty.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import six_axes as six
import stranger_six
from fuzzing import FACTOR
from short_records import Short, drawn

from bayes_aero.diagnosis import candidate_set
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.writers import write_record
from bayes_aero.inference.likelihood.disturbed import GUSTS
from bayes_aero.model.joined_records import plain_marks
from bayes_aero.model.model import Model
from bayes_aero.simulate.sensor_faults import misrecorded

CODES = {0, 1, 2, 3}
DEFECT = re.compile(r"defect of the program|Traceback|\b[A-Z]\w*(Error|Warning|Exception)\b")


def told(program, folder, *arguments, out=None):
    """What a command has said, which must not be a defect; with `out`, its JSON or None for bad input."""
    done = program(*arguments, *(("--out", folder / out) if out else ()))
    said = done.out + done.err
    assert done.code in CODES, (arguments, done.code, said)
    assert not DEFECT.search(said), (arguments, said)
    if done.code == 2:
        assert done.err.count("\n") == 1
        assert done.err.startswith("error: ")
        return done.code, said, None
    if out is None:
        return done.code, said, None
    (content,) = (json.loads(p.read_text()) for p in (folder / out).glob("*.json"))
    content.pop("provenance", None)
    assert content.get("failures", []) == []
    assert not DEFECT.search(json.dumps(content))
    page = re.sub(r"<(script|style).*?</\1>", "", (folder / out / "report.html").read_text(), flags=re.DOTALL)
    assert not DEFECT.search(page)
    return done.code, said, content | {"page": page}


def climbed(program, folder, short: Short, *, quick: bool):
    """All five commands one after the other: what each has said and written."""
    records, card = short.write(folder)
    given, more = (*records, "--model", card), ("--no-figures",) if quick else ()
    found = {"card": told(program, folder, "card", records[0], "--out", folder / "starter.toml")}
    found["check"] = told(program, folder, "check", *given, out="check")
    gp = () if not quick and "gp" in short.sections else ("--no-gp",)
    found["identify"] = told(program, folder, "identify", *given, "--no-sample", *gp, *more, out="identify")
    found["fly"] = told(program, folder, "fly", *given, *more, out="fly")
    found["diagnose"] = told(program, folder, "diagnose", *given, *more, out="diagnose")
    content = found["check"][2]
    if content is not None and content["records"][0]["usable"]:
        for command in ("identify", "fly", "diagnose"):
            assert (found[command][2] is not None) == content["uses"][command]["possible"], (command, found[command])
        if not content["uses"]["diagnose"]["possible"]:
            assert not re.search(r"diagnose looks? for", found["fly"][1]), found["fly"][1]
    return found


@pytest.mark.verify
def test_without_altitude(program, tmp_path):
    """Of 12 s; test points are chosen though no altitude was recorded."""
    short = Short(25.0, 12.4, without=("altitude",), constants={"density": "0.95 kg/m^3"})
    found = climbed(program, tmp_path, short, quick=True)
    assert found["diagnose"][2] is not None
    assert "altitude" in found["check"][2]["page"]


def test_without_accelerometers(program, tmp_path):
    """Of 12 s there is one window, and nothing to judge an effect by: that is said, and the model is flown."""
    short = Short(25.0, 12.4, without=("ax", "az", "p"), constants={"p": "0 rad/s"}, derived=("density",))
    found = climbed(program, tmp_path, short, quick=True)
    assert "ax" in found["identify"][1]
    assert "is one window" in found["diagnose"][1]
    assert found["fly"][2]["converged"]


def test_some_seconds(program, tmp_path):
    short = Short(25.0, 6.0, derived=("density", "mach"), sections=("sensors", "tolerances"))
    found = climbed(program, tmp_path, short, quick=True)
    assert "diagnose: not possible, a single manoeuvre of 6 s is too short" in found["check"][1]
    assert "give one of 13 s at least, or a second one" in found["diagnose"][1]


@pytest.mark.verify
def test_any_short_record(program, tmp_path, capsys):
    seed = int(np.random.SeedSequence().entropy) % (1 << 31)
    for number in range(max(3, int(FACTOR))):
        short = drawn(np.random.default_rng([seed, number]))
        with capsys.disabled():  # `program` discards what it captures
            print(f"\nseed {seed}, {number}: {short}")
        folder = tmp_path / str(number)
        folder.mkdir()
        climbed(program, folder, short, quick=False)


CARDS = sorted(path.stem for path in (Path(__file__).parents[2] / "models").glob("*.toml"))
SOUND = 324.6  # m/s, at 4000 m


@pytest.fixture(scope="module")
def gusty():
    """Two short manoeuvres of the aircraft of `full_six` in gusts, with all that the shipped cards read."""
    a, rng, found = read_card("full_six").aircraft, np.random.default_rng(5), {}
    same = {"mass": a.mass, "Ix": a.Ix, "Iy": a.Iy, "Iz": a.Iz, "Ixz": a.Ixz, "S": a.wing_area, "c": a.chord}
    same |= {"b": 2.0 * a.half_span, "tail": a.tail_arm, "engine_arm": a.engine_arm, "engine_drop": a.engine[2]}
    absent = dict.fromkeys(("CLde_extra", "CYr", "CYdr", "Cldr", "Cnda"), 0.0)
    plane = stranger_six.Plane(**six.ATTACHED, **same, **absent, nose=a.accelerometer)
    for kind in ("elevator", "rudder"):
        flight = stranger_six.fly(plane, kind, rng, seconds=9.0, gust=0.5)
        shown = six.recorded(flight, rng)
        t, V = shown.pop("time"), shown["airspeed"]
        shown |= {f"{n}_dot": np.gradient(flight[n], t) + 1e-3 * rng.standard_normal(len(t)) for n in "pqr"}
        shown |= {"v": V * np.sin(shown["beta"]), "w": V * np.sin(shown["alpha"]), "mach": V / SOUND}
        shown |= {"aileron_right": shown["aileron"], "aileron_left": -shown["aileron"]}
        found[kind] = shown | {"thrust": shown["thrust_left"] + shown["thrust_right"]}
    return t, found


def read_by(name, gusty, folder):
    """The card and files that it reads, with the errors of sensors that it states."""
    card, (t, flights) = read_card(name), gusty
    suffix, paths = ".csv" if all(c.label for c in card.channels) else ".asc", []
    for kind, true in flights.items():
        shown, paths = true, [*paths, folder / f"{kind}{suffix}"]
        if card.linear is None:
            model = Model.from_card(card)
            stated = {p.name: p.start for p in model.free} | dict(model.fixed)
            shown = misrecorded(model, stated, true, plain_marks(len(t), t[1] - t[0], 0), card.aircraft)
        write_record(FlightRecord.from_arrays(kind, t, shown, "simulated"), paths[-1], card.channels)
    return card, paths


def stages_of(found):
    """Stages in which effects were screened."""
    return {row["stage"] for row in found["screening"]}


def each(*effects):
    """Every card with and without process noise; of those with effects only these in every run, for they take long."""
    pairs = [(name, noise) for name in CARDS for noise in ("--process-noise", "--no-process-noise")]
    quick = [read_card(pair[0]).linear is not None or pair in effects for pair in pairs]
    marks = [[] if soon else [pytest.mark.verify] for soon in quick]
    given = [pytest.param(*pair, marks=own) for pair, own in zip(pairs, marks, strict=True)]
    return pytest.mark.parametrize(("name", "noise"), given)


@each(("full_six", "--no-process-noise"), ("hfb320", "--no-process-noise"))
def test_every_shipped_card_is_flown_to_the_end(name, noise, gusty, program, tmp_path):
    card, paths = read_by(name, gusty, tmp_path)
    found = told(program, tmp_path, "fly", *paths, "--model", name, noise, "--no-figures", out="flown")[2]
    assert found is not None
    assert (found.get("process_noise") is not None) == (noise == "--process-noise" and found["converged"])
    if found.get("process_noise") and len(card.axes) == 2:
        assert {"phi", "theta", "psi"} <= set(found["process_noise"]["F"])


@each()
def test_every_shipped_card_is_diagnosed_to_the_end(name, noise, gusty, program, tmp_path):
    card, paths = read_by(name, gusty, tmp_path)
    asked = ("diagnose", *paths, "--model", name, noise, "--no-test-points", "--no-figures")
    code, said, found = told(program, tmp_path, *asked, out="diagnosed")
    if card.linear is not None:
        assert code == 2
        assert f"card {name} states a linear system, which has no effects; use one with [model]" in said
        return
    assert found is not None
    assert ("innovations" in stages_of(found)) == (noise == "--process-noise")


@pytest.mark.recovery
def test_a_card_of_six_axes_is_diagnosed_in_gusts(gusty, program, tmp_path, monkeypatch):
    """The filter's states are angles of attitude, those of a simulation a quaternion. Few candidates compile sooner."""
    card, paths = read_by("full_six", gusty, tmp_path)
    kept = (*card.effects, "sideslip_scale", "elevator_lift", "aileron_yaw", *GUSTS, "lateral_gust")
    monkeypatch.setattr(candidate_set, "CATALOGUE", {name: CATALOGUE[name] for name in kept})
    asked = ("--process-noise", "--no-test-points", "--no-trajectories", "--no-figures", "--max-effects", 1)
    _, said, found = told(program, tmp_path, "diagnose", *paths, "--model", "full_six", *asked, out="diagnosed")
    assert found is not None, said
    assert stages_of(found) == {"innovations"}
