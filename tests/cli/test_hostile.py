"""Whatever a card, a study, a file or a name says, it is read or refused in one sentence, soon, without a warning."""

import os
import re
import shutil
import tomllib
import warnings
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from calling import answer, holds, refused
from flight.flight_samples import CHANNELS, sound
from fuzzing import examples
from hypothesis import given
from hypothesis import strategies as st
from linear_cards import SHORT_PERIOD
from scipy.io import savemat

from bayes_aero.errors import LONGEST, InputError
from bayes_aero.flight import text
from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.reading import read_raw, read_record
from bayes_aero.flight.record import write_record
from bayes_aero.jobs import store
from bayes_aero.jobs.store import write_json
from bayes_aero.model.model import Model, own_effects
from bayes_aero.study import run as unit_runs
from bayes_aero.study.run import read_study

ODD = (
    "true", "0", "-1", "1", "10000000000", "0x" + "f" * 30, "9" * 5000, "0.5", "-0.0", "1e308", "5e-324", "nan",
    "inf", "-inf", '""', '" "', '"1e999 kg"', '"9**9**9**9"', '"nan"', '"-1 m"', '"1 furlong"', '"ü°\u202e"', '"a\\nb"',
    '"\\u001b[31m"', '"../../etc/passwd"', '"/dev/zero"', '"[red]"', '"</script>"', f'"{"x" * 5000}"', "[]", "[[]]",
    "{}", "[1, 2]", '["a", "a"]', "{a = {a = {}}}", "[" * 16 + "1" + "]" * 16,
)  # fmt: skip
KINDS = st.sampled_from(["drop", "double", "swap", "inside", "inside", "set", "set"])
CHANGES = st.lists(st.tuples(KINDS, *[st.integers(0, 10_000)] * 2, st.sampled_from(ODD)), min_size=1, max_size=4)


def one_a_line(text):
    """The entries of a table, of which a list may take several lines."""
    return re.sub(r"(?<=[\[,])\s*\n\s*", " ", text)


def changed(text):
    """Entries dropped, given twice, swapped, and set to what is odd, the whole of them or a part."""
    lines = [line for line in one_a_line(text).splitlines() if line]

    def apply(changes):
        new = list(lines)
        for kind, at, other, odd in changes:
            i, j = at % len(lines), other % len(lines)
            key, _, value = new[i].partition(" = ")
            parts = re.findall(r'"[^"]*"|[\w.+-]+', value)
            if kind == "inside" and parts:
                new[i] = new[i].replace(parts[other % len(parts)], odd)
            else:
                swapped = f"{key} = {new[j].partition(' = ')[2]}"
                new[i] = {"drop": "", "double": f"{new[i]}\n{new[j]}", "swap": swapped}.get(kind, f"{key} = {odd}")
        return "\n".join(new).encode("utf-8", "surrogatepass")

    return CHANGES.map(apply)


ATTAS = shipped_cards()["attas"].read_text(encoding="utf-8")
STUDY = """
title = "a study"
task = "identify"
records = ["flights/*.csv", "flights/a.csv"]
one_by_one = true
cards = ["attas", "mine.toml"]
seeds = [0, 1]
splits = ["random", "block"]
noise = ["white", "ar1"]
effects = [[], ["alpha_squared_moment"]]
options = { gp = false, figures = false, resample = 0.04 }
"""


def sentence_of(read, path) -> str:
    """The sentence with which it was refused; empty where it was read."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read(path)
        except InputError as reason:
            said = str(reason)
            assert said
            assert said.isprintable() or "\xa0" in said
            assert len(said) <= LONGEST + 10
            return said
    return ""


def modelled(path):
    card = read_card(path)
    if card.linear is None:
        Model.from_card(card)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("hostile")
    (place / "flights").mkdir()
    for name in ("a", "b"):
        (place / "flights" / f"{name}.csv").write_text("time\n0\n")
    shutil.copy(shipped_cards()["attas"], place / "mine.toml")
    return place


TEXT = ATTAS.encode()
CUTS = st.tuples(st.integers(0, len(TEXT)), st.integers(0, 200), st.binary(max_size=10))
CONTENTS = st.binary(max_size=300) | CUTS.map(lambda cut: TEXT[: cut[0]] + cut[2] + TEXT[cut[0] + cut[1] :])
CONTENTS |= st.text(alphabet="[]{}=\"'.,#\n\\abtu01e-+_: \0é", max_size=300).map(str.encode)


@pytest.mark.parametrize(("read", "contents", "count"), [
    (modelled, changed(ATTAS), 200), (modelled, changed(SHORT_PERIOD), 200),
    (read_study, changed(STUDY), 100), (modelled, CONTENTS, 100), (read_study, CONTENTS, 100),
], ids=["attas", "linear", "study", "bytes of a card", "bytes of a study"])  # fmt: skip
def test_changed_tables_bytes_and_text(folder, read, contents, count):
    @examples(count)
    @given(contents)
    def run(content):
        (folder / "any.toml").write_bytes(content)
        sentence_of(read, folder / "any.toml")

    run()


def test_the_unchanged_ones_are_read(folder):
    for card in (ATTAS, SHORT_PERIOD):
        assert tomllib.loads(one_a_line(card)) == tomllib.loads(card)
        (folder / "same.toml").write_text(one_a_line(card))
        assert sentence_of(modelled, folder / "same.toml") == ""
    (folder / "same.toml").write_text(STUDY)
    assert len(read_study(folder / "same.toml").units) == 2 * 2 * 2 * 2 * 2 * 2


# What fuzzing and thinking like an attacker have found; none may come back
@pytest.mark.parametrize(("content", "said"), [
    ("x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
    ("x = " + "{a = " * 30 + "1" + "}" * 30, "nested deeper than"),
    ("x = " + "1" * 5000, "not valid TOML"),  # Python refuses to read so many digits
    ("x = 0x" + "f" * 5000, "more than 18 digits"),  # reads them, but float() and str() do not take them
    (".".join("a" * 50_000) + " = 1", "more than 12 parts"),  # tomllib: the square of the parts, hours
    ("[" + " . ".join(['"a"'] * 20_000) + "]", "more than 12 parts"),
    ('title = "' + "x" * 300_000 + '"', "more than 262144 bytes"), ('"' + "k" * 1000 + '" = 1', "is no name"),
    ('"a\\u001b[31m" = 1', "is no name"), ("\0", "not valid TOML"),
])  # fmt: skip
@pytest.mark.parametrize("read", [read_card, read_study])
def test_tables_that_no_one_writes(tmp_path, read, content, said):
    (tmp_path / "odd.toml").write_text(content)
    with pytest.raises(InputError, match=said) as reason:
        read(tmp_path / "odd.toml")
    assert len(str(reason.value)) < LONGEST


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "/dev/zero", "/dev/null/x", "."])
def test_names_that_no_table_has(name):
    for read in (read_card, read_study):
        with pytest.raises(InputError):
            read(Path(name))


@pytest.mark.parametrize(("line", "said"), [
    ("task = { a = 1 }", "task must be one of"),  # unhashable
    (f"seeds = [{', '.join(map(str, range(30_000)))}, 0]", "lists 0 twice"),  # was the square of their number
    ("seeds = [4294967296]", "whole numbers from 0 to"), ('records = ["a\\u0000b.csv"]', "does not exist"),
    (f'records = ["{"x" * 300}.csv"]', "does not exist"), (f'cards = ["{"x" * 300}.toml"]', "does not exist"),
    ("[options]\nresample = nan", "must be positive"),
])  # fmt: skip
def test_studies_that_no_one_writes(tmp_path, line, said):
    (tmp_path / "a.csv").write_text("time\n0\n")
    records = "" if line.startswith("records") else 'records = ["a.csv"]\n'
    (tmp_path / "study.toml").write_text(records + line)
    with pytest.raises(InputError, match=said):
        read_study(tmp_path / "study.toml")


def test_a_sentence_is_one_line_and_cannot_speak_to_the_terminal():
    said = str(InputError("channel 'a\n\x1b]0;title\x07\u202e\ud800' " + "x" * 10_000))
    assert said.isprintable()
    assert "\\x1b" in said
    assert len(said) < LONGEST + 10
    assert said.encode()


@pytest.mark.parametrize("suffix", [".mat", ".parquet", ".nc"])
def test_small_files_that_claim_gigabytes(tmp_path, suffix, monkeypatch):
    """Ten channels of many zeros each: some kB compressed or never written."""
    rows, path = 19_000_000 if suffix == ".nc" else 190_000, tmp_path / f"big{suffix}"
    if suffix != ".nc":  # zeros must be written there; the limit of all is the thing
        monkeypatch.setattr("bayes_aero.flight.text.MOST_VALUES_IN_ALL", 1_000_000)
    channels = (Channel("time", "s", "T", 1), *(Channel(f"c{i}", "1", f"C{i}", i) for i in range(2, 11)))
    columns = dict.fromkeys((channel.heading for channel in channels), np.zeros(190_000))
    if suffix == ".nc":
        with h5py.File(path, "w") as file:
            for name in columns:
                file.create_dataset(name, (rows,), "f8", chunks=(1_000_000,), compression="gzip")
    elif suffix == ".mat":
        savemat(path, columns, do_compression=True)
    else:
        pq.write_table(pa.table(columns), path)
    assert path.stat().st_size < 5_000_000
    with pytest.raises(InputError, match=r"more (values )?than"):
        read_record(path, channels)


def test_an_hdf5_header_that_claims_more_than_there_is(tmp_path):
    with h5py.File(tmp_path / "big.nc", "w") as file:
        for channel in CHANNELS:
            file.create_dataset(channel.heading, (2**62,), "f8", chunks=(1000,))
    with pytest.raises(InputError, match="claims"):
        read_record(tmp_path / "big.nc", CHANNELS)


WIDE = "\n".join(",".join(f"{k}{i}" for i in range(25_000)) for k in ("c", "1", "2")).encode()


@pytest.mark.parametrize(("content", "said"), [
    (lambda: b"1," * 50_000_000, "characters, more than"), (lambda: b"1,2\n" * 6_000_000, "lines, more than"),
    (lambda: b"\r" * 50_000_000, "lines, more than"),  # the first is one line of 100 MB
    (lambda: (b"T,ALCG\n" + b"9" * 150_000 + b",1\n1,2\n") * 60, "column"), (lambda: WIDE, "25000 columns, more than"),
], ids=["line", "lines", "returns", "digits", "wide"])  # fmt: skip
def test_text_that_is_no_table(tmp_path, content, said):
    (tmp_path / "odd.csv").write_bytes(content())
    with pytest.raises(InputError, match=said):
        read_record(tmp_path / "odd.csv", CHANNELS)


def test_numbers_far_beyond_any_record_are_refused(tmp_path):
    write_record(sound(60), tmp_path / "sound.csv", CHANNELS)
    with pytest.raises(InputError, match="makes more than"):
        read_record(tmp_path / "sound.csv", CHANNELS, resample=1e-12)
    assert b"column = 1," in TEXT
    (tmp_path / "far.toml").write_bytes(TEXT.replace(b"column = 1,", b"column = 1000000000000,", 1))
    with pytest.raises(InputError, match="no file has more than"):
        read_card(tmp_path / "far.toml")
    assert text.MOST_LINES > 20 * 200_000
    assert text.LONGEST_LINE > 2000 * 25


def test_many_columns_of_words_are_not_read_one_by_one(tmp_path, monkeypatch):
    calls = []
    read = text.read_cells
    monkeypatch.setattr(text, "read_cells", lambda *given: calls.append(1) or read(*given))
    monkeypatch.setattr("bayes_aero.flight.reading.PATIENCE", 3.0)
    rows = [",".join(["1"] * 500 + ["word"] * 500) + f",{0.1 * k}" for k in range(9)]
    rows = [",".join(f"c{i}" for i in range(1000)) + ",t", *rows]
    (tmp_path / "words.csv").write_text("\n".join(rows))
    columns = {column.label: column for column in read_raw(tmp_path / "words.csv").columns}
    assert [columns[name].values is None for name in ("t", "c7", "c700")] == [False, False, True]
    assert len(calls) < 1100  # twice the words at most


@pytest.mark.parametrize("content", ["[" * 100_000 + "]" * 100_000, "[]", "null", '{"id": []}', "\xff"])
def test_damaged_json_in_a_results_folder(tmp_path, content):
    """Deep nesting raised RecursionError, a list AttributeError."""
    folder = tmp_path / "environment"
    folder.mkdir()
    (folder / "environment.json").write_text(content)
    store.write_environment(tmp_path)
    assert (folder / "environment.json").read_text() == content
    assert len(list(tmp_path.glob("environment-*/environment.json"))) == 1
    (tmp_path / unit_runs.MANIFEST).write_text(content)
    unit = unit_runs.Unit("u", "identify", (), (), "attas", "attas", 0, None, None, ())
    assert unit_runs.state_of(unit, tmp_path).state == "damaged"
    for name in ("/etc/hostname", "../../../../../../etc/hostname", "a\0b", "x" * 300):
        manifest = {"files": {name: ""}, "made_from": unit_runs.fingerprint(unit), "state": "done"}
        write_json(manifest, tmp_path / unit_runs.MANIFEST)
        assert unit_runs.state_of(unit, tmp_path).state == "damaged"


@pytest.mark.parametrize(("name", "source", "said"), [
    ("exits.py", b"import sys\nsys.exit(0)\n", "SystemExit"), ("long.py", b"x = 1\n" * 300_000, "more than"),
    ("bytes.py", b"\xff\xfe", "cannot be read"), ("/dev/zero", b"", "no such file"), (".", b"", "no such file"),
], ids=["exits", "long", "bytes", "device", "folder"])  # fmt: skip
def test_effect_files_that_are_none(tmp_path, name, source, said):
    if source:
        (tmp_path / name).write_bytes(source)
    with pytest.raises(InputError, match=said):
        own_effects([tmp_path / name])


@pytest.mark.parametrize(
    "name", ["..; rm -rf $(x) ü.csv", "con.x.csv", "NUL.csv", ".hidden.csv", "-rf.csv", "a" * 200 + ".csv"]
)
def test_names_of_units_are_names_of_folders_everywhere(tmp_path, name):
    shutil.copy(shipped_cards()["attas"], tmp_path / name)
    (tmp_path / "study.toml").write_text(f'records = ["{name}"]\ntitle = "../../x"\n')
    (only,) = read_study(tmp_path / "study.toml").units
    assert os.path.basename(only.name) == only.name
    assert only.name[0] not in ".-"
    assert only.name.isascii()
    assert only.name.split(".")[0].lower() not in {"con", "nul"}
    assert len(only.name) <= 110


# Code is run only if the user has named the card, or said so; nothing is written outside the folder named
EFFECT = (Path(__file__).parents[1] / "model" / "test_cards.py").read_text(encoding="utf-8").split("'''")[1]


@pytest.fixture
def trap(tmp_path, flights):
    """A folder with records and, beside them, a card whose effect file leaves a mark when it is run."""
    shutil.copy(flights.sound, tmp_path / "flight.csv")
    mark = tmp_path / "ran"
    (tmp_path / "trap.py").write_text(f"open({str(mark)!r}, 'w').close()\n{EFFECT}")
    text = shipped_cards()["attas"].read_text().replace("[model]\n", '[model]\neffect_files = ["trap.py"]\n')
    for name in ("attas", "attas.toml", "card.toml", "flight.toml", "flight.csv.toml", "mine.toml"):
        (tmp_path / name).write_text(text)
    (tmp_path / "study.toml").write_text('records = ["flight.csv"]\ncards = ["mine.toml"]\noptions.gp = false\n')
    return mark


@pytest.fixture
def quick(monkeypatch):
    """A unit's work that only looks at its card."""

    def perform(unit, out, *_):
        write_json({"effects": len(unit_runs.card_of(unit).effects)}, out / "results.json")

    monkeypatch.setattr(unit_runs, "run_task", perform)


def test_a_card_that_lies_about_is_not_taken(program, trap):
    assert program("check", "flight.csv", "--no-sensors").code == 0  # the default is `attas`
    assert program("check", "flight.csv", "--no-sensors", "--model", "attas").code == 0
    assert program("effects", "--model", "attas").code == 0
    assert read_card("attas").effect_files == ()
    assert not trap.exists()
    assert program("effects", "--model", "./attas").code == 0  # now the user has named it
    assert trap.exists()


@pytest.mark.usefixtures("trap")
def test_effects_of_a_card_are_listed_with_it_alone(program):
    (effect,) = answer(program("effects", "bank_pitching", "--model", "mine.toml", "--json"))["effects"]
    assert (effect["claim"], effect["model"]) == ("Bank pitches the aircraft.", False)
    refused(program("effects", "bank_pitching"), "bank_pitching")


@pytest.mark.usefixtures("quick")
def test_a_study_runs_no_code_unless_it_is_told_to(program, trap):
    for more in ([], ["--dry-run"]):
        refused(program("run", "study.toml", *more), "trap.py", "--trust-effects", gone=["study_results"])
    Path("shipped.toml").write_text('records = ["flight.csv"]\ncards = ["attas"]\n')
    Path("big_disk").mkdir()
    Path("link").symlink_to("big_disk", target_is_directory=True)  # the folder itself may be one
    assert program("run", "shipped.toml", "--out", "link").code == 0  # not the card of this name that lies here
    assert Path("big_disk/units.csv").is_file()
    assert not trap.exists()
    assert program("run", "study.toml", "--trust-effects").code == 0
    assert trap.exists()


@pytest.mark.usefixtures("quick", "trap")
@pytest.mark.parametrize(("asked", "link"), [
    ("run study.toml", "study_results/units"), ("run study.toml", "study_results/units/x"),
    ("run study.toml", "study_results/environment"), ("identify flight.csv --out out", "out/figures"),
    ("diagnose flight.csv --out out", "out/report.html"), ("identify flight.csv --out out", "out/results.json.part"),
])  # fmt: skip
def test_links_in_the_folder_of_results_lead_nowhere(program, asked, link):
    Path("study.toml").write_text('records = ["flight.csv"]\n')
    victim = Path("outside/victim").resolve()
    victim.parent.mkdir()
    victim.write_text("untouched")
    Path(link).parent.mkdir(parents=True)
    Path(link).symlink_to(victim.parent if asked.startswith("run") else victim)
    done = program(*asked.split())
    assert done.code == 2
    assert "leads out of" in done.err
    assert [(path.name, path.read_text()) for path in victim.parent.iterdir()] == [("victim", "untouched")]


LONG, SIMULATE = "x" * 300, "simulate --out f.csv"
BAD = {  # of every command: what it is asked, and a word of the sentence
    "identify nowhere.csv": "nowhere.csv", "diagnose empty.csv": "empty.csv", "identify --model atas": "attas",
    "identify --model bad.toml": "efects", "identify flight.csv --resample nan": "resample",
    f"diagnose flight.csv --out {LONG}": "too long", f"check flight.csv --model {LONG}": "no card",
    "effects pitch_rat_bias": "pitch_rate_bias", f"run {LONG}.toml": "check the path",
    f"check {LONG}.csv": "check its name", f"{SIMULATE} --effect pitch_rat_bias=1": "pitch_rate_bias",
    f"{SIMULATE} --effect pitch_rate_bias": "NAME=VALUE",
    f"{SIMULATE} --effect flow_separation=3": "flow_separation.alpha_star=VALUE",
    f"{SIMULATE} --effect thrust_lag=-1": "between 0 and 20", f"{SIMULATE} --effect thrust_lag=1kg": "kg",
    f"{SIMULATE} --effect kirchhoff_lift=1": "no parameter", f"{SIMULATE} --dt 1e-12": "0.1 s",
    f"{SIMULATE} --duration 1e15": "random_stall", f"{SIMULATE} --duration nan": "random_stall",
    "simulate --out nowhere/a.csv": "there is no folder nowhere", f"simulate --out {LONG}.csv": "too long",
    f"{SIMULATE} --manoeuvre aileron_doublet": "lateral axis",
    "fly flight.csv --frequency 0.1 1.5": "identify --frequency",
    "identify flight.csv --next-flight": "2 to 24 manoeuvres, and there is 1",
    "run study.toml --workers 2 --memory 4GiB": "give fewer --workers",
    "run study.toml --workers 100000": "are too little",
    "run study.toml --workers 2 --dry-run": "leave --workers",
    "run study.toml --workers 2 --scheduler tcp://127.0.0.1:9": "exclude each other",
}  # fmt: skip


@pytest.mark.usefixtures("trap")
@pytest.mark.parametrize("asked", BAD, ids=lambda asked: asked[:60])
def test_bad_input_is_one_sentence_and_nothing_is_written(program, tmp_path, asked):
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "study.toml").write_text('records = ["flight.csv"]\n')
    (tmp_path / "bad.toml").write_text('[aircraft]\n[channels]\n[model]\nefects = ["attached_lift"]\n')
    before = set(tmp_path.iterdir())
    refused(program(*asked.split()), BAD[asked])
    assert set(tmp_path.iterdir()) == before


def test_markup_in_headings_reaches_no_terminal(program, trap):
    content = Path("flight.csv").read_text().split("\n", 1)
    rows = "\n".join(f"{line},1,2" for line in content[1].split())
    Path("[red].csv").write_text(content[0] + ",[/bold],[link=file:///etc]x[/]\n" + rows)
    done = program("check", "[red].csv", "--no-sensors")
    holds(done.out, "[red].csv", "'[/bold]'")
    assert not trap.exists()


@pytest.mark.usefixtures("trap")
@pytest.mark.parametrize(("command", "option"), [
    ("diagnose --max-effects 0", "--max-effects"), ("simulate --out no.csv --seed 4294967296", "--seed"),
])  # fmt: skip
def test_numbers_out_of_range_name_their_option(program, command, option):
    done = program(*command.split())
    assert (done.code, option in done.err, "Traceback" in done.out + done.err) == (2, True, False)
