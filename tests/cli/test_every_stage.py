"""Every command on records of some seconds, with every shipped card, and with channels and entries of a card left out.

A few are fixed. `make verify` draws three at random and says their seed; with `FUZZ=20` in the environment twenty."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import six_axes as six
import stranger_six
from fuzzing import FACTOR
from stranger import NOISE, fly, plane

from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord, write_record
from bayes_aero.model.model import Model
from bayes_aero.model.records import plain_marks
from bayes_aero.simulate.injection import misrecorded

UNITS = {
    "time": "s", "airspeed": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s", "ax": "m/s^2", "az": "m/s^2",
    "altitude": "m", "elevator": "rad", "thrust": "N", "p": "rad/s", "r": "rad/s",
}  # fmt: skip
OPTIONAL = ("theta", "altitude", "p", "r", "ax", "az", "thrust", "elevator")
HELD = {"density": "0.95 kg/m^3", "thrust": "3000 N", "p": "0 rad/s", "r": "0 rad/s"}
ATTACHED = (
    "attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = ("flow_separation", "kirchhoff_lift", "separated_drag", "separated_moment")
AIR = "standard atmosphere"
SOUND = 324.6  # m/s, at 4000 m
SECTIONS = {
    "sensors": 'alpha = "0.05 deg"\nq = "0.05 deg/s"\nax = "0.02 m/s^2"',
    "tolerances": 'alpha = "1 deg"\nq = "1 deg/s"',
    "output_biases": 'alpha = "0.5 deg"',
    "gp": 'inputs = ["alpha", "alpha", "q"]',
    "parameters.CL0": "start = 0.3",
}
RATES, LENGTHS, BEGINS = (5, 10, 20, 25, 50, 100), (6, 8, 12, 14, 18, 25), (2, 4, 10, 16, 30)  # Hz, s, s
DEFECT = re.compile(r"defect of the program|Traceback|\b[A-Z]\w*(Error|Warning|Exception)\b")


def written(
    folder, seconds, *, without=(), effects=ATTACHED, rate=25.0, begin=2.0, records=1, noise=1.0, seed=0, **more
):
    """Records of what is flown from `begin` s on, and their card with `more` sections: lines, or values by name."""
    rng, dt = np.random.default_rng(seed), 1.0 / rate
    aircraft, files = plane(rng), []
    for number in range(records):
        rows = fly(aircraft, rng, dt, seconds=begin + seconds + 1.0)
        rows = rows[:, round(begin / dt) :][:, : round(seconds / dt) + 1]
        rows = rows + noise * np.array(NOISE)[:, None] * rng.standard_normal(rows.shape)
        still = 9e-4 * rng.standard_normal((2, rows.shape[1]))
        columns = {n: x for n, x in zip(UNITS, (*rows, *still), strict=True) if n not in without}
        files.append(folder / f"run{number}.csv")
        table = np.array(list(columns.values())).T
        np.savetxt(files[-1], table, delimiter=",", header=",".join(columns), comments="", fmt="%.8g")
    p, table = aircraft, {n: x if isinstance(x, dict) else {"": x} for n, x in more.items()}
    inertia = dict.fromkeys(("Ix", "Iy", "Iz"), f"{p.Iy} kg m^2") | {"Ixz": "0 kg m^2"}
    sizes = {"wing_area": f"{p.S} m^2", "chord": f"{p.c} m", "span": f"{p.b} m", "tail_arm": f"{p.tail} m"}
    lines = ["[aircraft]", *(f'{n} = "{x}"' for n, x in ({"mass": f"{p.mass} kg"} | inertia | sizes).items())]
    lines += ["[channels]", *(f'{n} = {{ label = "{n}", unit = "{UNITS[n]}" }}' for n in columns)]
    for name, entries in table.items():
        lines += [f"[{name}]", *(f'{n} = "{x}"' if n else x for n, x in entries.items())]
    (folder / "card.toml").write_text("\n".join([*lines, "[model]", f"effects = {json.dumps(effects)}"]))
    return files, folder / "card.toml"


def drawn(rng):
    """Any of them: channels, constants, sections and effects left out at random."""
    without = tuple(name for name in OPTIONAL if rng.random() < 0.1)
    constants = {n: v for n, v in HELD.items() if n in without and rng.random() < 0.85}
    derived = dict.fromkeys(("density", "mach")[: int(rng.integers(1, 3))], AIR)
    if "altitude" in without or rng.random() < 0.2:
        derived, constants = {}, constants | {"density": HELD["density"]}
    flat = {"phi": "0 deg", "beta": "0 deg", "ay": "0 m/s^2"}
    effects = tuple(e for e in ATTACHED if e != "elevator_moment" or "elevator" not in without)
    if rng.random() < 0.3:
        effects = tuple(str(e) for e in rng.permutation(effects)[: int(rng.integers(1, 5))])
    if rng.random() < 0.3:
        effects += (*STALL, *(("separation_lag",) if rng.random() < 0.3 else ()))
    sections = {name: lines for name, lines in SECTIONS.items() if rng.random() < 0.3}
    if "attached_lift" not in effects:
        sections.pop("parameters.CL0", None)
    constants |= {n: v for n, v in flat.items() if rng.random() < 0.4}
    chosen = {"rate": RATES, "seconds": LENGTHS, "begin": BEGINS, "records": (1, 1, 2), "noise": (0.0, 1.0, 1.0, 3.0)}
    numbers = {name: rng.choice(values).item() for name, values in chosen.items()}
    numbers |= {"seed": int(rng.integers(1 << 30)), "without": without, "effects": effects}
    return numbers | {"constants": constants, "derived": derived, **sections}


def ended(program, folder, *arguments, out=None):
    """What a command has said, which must not be a defect; with `out`, its JSON or None for bad input."""
    done = program(*arguments, *(("--out", folder / out) if out else ()))
    said = done.out + done.err
    assert done.code in (0, 1, 2, 3), (arguments, done.code, said)
    assert not DEFECT.search(said), (arguments, said)
    if done.code == 2:
        assert done.err.count("\n") == 1
        assert done.err.startswith("error: ")
    if done.code == 2 or out is None:
        return said, None
    (content,) = (json.loads(p.read_text()) for p in (folder / out).glob("*.json"))
    content.pop("provenance", None)
    assert content.get("failures", []) == []
    assert not DEFECT.search(json.dumps(content))
    page = re.sub(r"<(script|style).*?</\1>", "", (folder / out / "report.html").read_text(), flags=re.DOTALL)
    assert not DEFECT.search(page)
    return said, content | {"page": page}


def climbed(program, folder, seconds, *, quick=True, **short):
    """All five commands one after the other: what each has said and written."""
    records, card = written(folder, seconds, **short)
    given, more = (*records, "--model", card), ("--no-figures",) if quick else ()
    gp = () if not quick and "gp" in short else ("--no-gp",)
    asked = {"check": (), "identify": ("--no-sample", *gp, *more), "fly": more, "diagnose": more}
    stages = {"card": ended(program, folder, "card", records[0], "--out", folder / "starter.toml")}
    stages |= {name: ended(program, folder, name, *given, *options, out=name) for name, options in asked.items()}
    content = stages["check"][1]
    if content is not None and content["records"][0]["usable"]:
        for command in ("identify", "fly", "diagnose"):
            assert (stages[command][1] is not None) == content["uses"][command]["possible"], (command, stages[command])
        if not content["uses"]["diagnose"]["possible"]:
            assert not re.search(r"diagnose looks? for", stages["fly"][0]), stages["fly"][1]
    return stages


def test_without_accelerometers(program, tmp_path):
    """Of 12 s there is one window, and nothing to judge an effect by: that is said, and the model is flown."""
    more = {"constants": {"p": "0 rad/s"}, "derived": {"density": AIR}}
    stages = climbed(program, tmp_path, 12.4, without=("ax", "az", "p"), **more)
    assert "ax" in stages["identify"][0]
    assert "is one window" in stages["diagnose"][0]
    assert stages["fly"][1]["converged"]


def test_some_seconds(program, tmp_path):
    stated = {name: SECTIONS[name] for name in ("sensors", "tolerances")}
    (record,), card = written(tmp_path, 6.0, derived={"density": AIR, "mach": AIR}, **stated)
    checked = ended(program, tmp_path, "check", record, "--model", card, out="check")[0]
    assert "diagnose: not possible, a single manoeuvre of 6 s is too short" in checked
    diagnosed = ended(program, tmp_path, "diagnose", record, "--model", card, out="diagnose")[0]
    assert "give one of 13 s at least, or a second one" in diagnosed


@pytest.mark.verify
def test_any_short_record(program, tmp_path):
    seed = int(np.random.SeedSequence().entropy) % (1 << 31)
    for number in range(max(3, int(FACTOR))):
        short = drawn(np.random.default_rng([seed, number]))
        print(f"\nseed {seed}, {number}: {short}")
        folder = tmp_path / str(number)
        folder.mkdir()
        climbed(program, folder, quick=False, **short)


@pytest.fixture(scope="module")
def gusty():
    """Two short manoeuvres of the aircraft of `full_six` in gusts, with all that the shipped cards read."""
    a, rng, flights = read_card("full_six").aircraft, np.random.default_rng(5), {}
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
        flights[kind] = shown | {"thrust": shown["thrust_left"] + shown["thrust_right"]}
    return t, flights


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


CARDS = sorted(path.stem for path in (Path(__file__).parents[2] / "models").glob("*.toml"))
NOISE_OR_NONE = ("--process-noise", "--no-process-noise")
PAIRS = [(name, noise) for name in CARDS for noise in NOISE_OR_NONE]


@pytest.mark.verify
@pytest.mark.parametrize(("name", "noise"), PAIRS)
def test_every_shipped_card_is_flown_to_the_end(name, noise, gusty, program, tmp_path):
    card, paths = read_by(name, gusty, tmp_path)
    content = ended(program, tmp_path, "fly", *paths, "--model", name, noise, "--no-figures", out="flown")[1]
    assert content is not None
    assert (content.get("process_noise") is not None) == (noise == NOISE_OR_NONE[0] and content["converged"])
    if content.get("process_noise") and len(card.axes) == 2:
        assert {"phi", "theta", "psi"} <= set(content["process_noise"]["F"])


@pytest.mark.verify
@pytest.mark.parametrize(("name", "noise"), [p for p in PAIRS if read_card(p[0]).linear is None])
def test_every_shipped_card_of_effects_is_diagnosed_to_the_end(name, noise, gusty, program, tmp_path):
    _, paths = read_by(name, gusty, tmp_path)
    asked = ("diagnose", *paths, "--model", name, noise, "--no-test-points", "--no-figures")
    content = ended(program, tmp_path, *asked, out="diagnosed")[1]
    assert content is not None
    assert ("innovations" in {row["stage"] for row in content["screening"]}) == (noise == NOISE_OR_NONE[0])
