"""Every command on records of some seconds with channels and entries of the card left out: it ends in a sentence, and
the page says what could not be done.

A few are fixed. `make verify` draws three at random, other ones each time, and says their seed; with `FUZZ=20` in the
environment twenty.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from fuzzing import FACTOR
from short_records import Short, drawn

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
def test_without_altitude_and_too_short_for_a_discrepancy(program, tmp_path):
    """12 s leave one block to fit the discrepancy to; manoeuvres are designed though no altitude was recorded."""
    short = Short(25.0, 12.4, without=("altitude",), constants={"density": "0.95 kg/m^3"})
    found = climbed(program, tmp_path, short, quick=True)
    diagnosis = found["diagnose"][2]
    assert set(diagnosis["predictors"]) == {"card", "gp", "extended", "extended_gp"}
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
