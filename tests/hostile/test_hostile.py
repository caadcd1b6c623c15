"""Whatever a card, a study, a file or a name says, it is read or refused in one sentence, soon, without a warning.

Changed cards and studies at random, and what fuzzing and thinking like an attacker have found, one example each.
"""

import copy
import json
import math
import os
import shutil
import time
import tomllib
import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
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
from bayes_aero.model.model import Model, own_effects
from bayes_aero.study import run as unit
from bayes_aero.study.run import read_study

ODD = (
    None, True, 0, -1, 1, 10**12, 10**30, 10**5000, 2**63, 0.5, -0.0, 1e308, 5e-324, math.nan, math.inf, -math.inf, "",
    " ", "1e999 kg", "9**9**9**9", "nan", "-1 m", "1 furlong", "ü°\u202e", "a\nb", "\x1b[31m", "../../etc/passwd",

    "/dev/zero", "[red]", "</script>", "x" * 5000, [], [[]], {}, [1, 2], ["a", "a"], {"a": {"a": {}}},
    [[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]],
)  # fmt: skip


def places(table: Any, path: tuple = ()) -> list[tuple]:
    """The way to every entry."""
    found = []
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        found += [(*path, key), *places(value, (*path, key))]
    return found


def mutated(table: dict[str, Any], changes: list[tuple[str, int, int, Any]]) -> dict[str, Any]:
    """Entries dropped, given twice under near names, retyped, swapped, wrapped."""
    table = copy.deepcopy(table)
    for kind, one, other, value in changes:
        ways = places(table)
        if not ways:
            break
        *way, last = ways[one % len(ways)]
        holder = table
        for key in way:
            holder = holder[key]
        if kind == "drop":
            del holder[last]
        elif kind == "double" and isinstance(holder, dict):
            holder[f"{last}_"] = holder[last]
        elif kind == "double":
            holder.append(holder[last])
        elif kind == "wrap":
            holder[last] = [holder[last]] if other % 2 else {str(last): holder[last]}
        elif kind == "swap":
            source: Any = table
            for key in ways[other % len(ways)]:
                source = source[key]
            holder[last] = copy.deepcopy(source)
        elif kind == "rename" and isinstance(holder, dict):
            holder[value if isinstance(value, str) else "odd"] = holder.pop(last)
        else:
            holder[last] = copy.deepcopy(value)
    return table


def changes(values=st.sampled_from(ODD)):
    """What `mutated` takes."""
    kinds = st.sampled_from(["drop", "double", "wrap", "swap", "rename", "set", "set", "set"])
    numbers = st.integers(0, 10_000)
    return st.lists(st.tuples(kinds, numbers, numbers, values), min_size=1, max_size=4)


def toml(value: dict[str, Any]) -> str:
    """A document with one inline value a line; whatever TOML cannot say stands there all the same."""
    return "".join(f"{_inline(str(key))} = {_inline(inner)}\n" for key, inner in value.items())


def _inline(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_inline(str(k))} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, int) and value > 2**70:
        return hex(value)
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


CARDS = {
    "attas": tomllib.loads(shipped_cards()["attas"].read_text(encoding="utf-8")),
    "linear": tomllib.loads(SHORT_PERIOD),
}
STUDY = {
    "title": "a study", "task": "identify", "records": ["flights/*.csv", "flights/a.csv"], "one_by_one": True,
    "cards": ["attas", "mine.toml"], "seeds": [0, 1], "splits": ["random", "block"], "noise": ["white", "ar1"],
    "effects": [[], ["alpha_squared_moment"]], "options": {"gp": False, "figures": False, "resample": 0.04},
}  # fmt: skip


def refused(read, path) -> str:
    """The sentence with which it was refused; empty where it was read."""
    with warnings.catch_warnings(record=True) as leaked:
        warnings.simplefilter("always")
        try:
            read(path)
            said = ""
        except InputError as reason:
            said = str(reason)
            assert said
            assert said.isprintable() or "\xa0" in said
            assert len(said) <= LONGEST + 10
    assert not leaked, leaked
    return said


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


@pytest.mark.parametrize(
    ("table", "read", "count"),
    [(CARDS["attas"], modelled, 200), (CARDS["linear"], modelled, 200), (STUDY, read_study, 100)],
    ids=["attas", "linear", "study"],
)
def test_changed_tables(folder, table, read, count):
    @examples(count)
    @given(changes())
    def run(wrong):
        path = folder / "changed.toml"
        path.write_text(toml(mutated(table, wrong)), encoding="utf-8", errors="surrogatepass")
        refused(read, path)

    run()


@pytest.mark.parametrize("read", [modelled, read_study])
def test_bytes_and_text(folder, read):
    text = shipped_cards()["attas"].read_bytes()

    @examples(100)
    @given(
        st.binary(max_size=300)
        | st.text(alphabet="[]{}=\"'.,#\n\\abtu01e-+_: \0é", max_size=300).map(str.encode)
        | st.tuples(st.integers(0, len(text)), st.integers(0, 200), st.binary(max_size=10)).map(
            lambda cut: text[: cut[0]] + cut[2] + text[cut[0] + cut[1] :]
        )
    )
    def run(content):
        path = folder / "any.toml"
        path.write_bytes(content)
        refused(read, path)

    run()


def test_the_unchanged_ones_are_read(folder):
    for name, table in CARDS.items():
        (folder / f"{name}_same.toml").write_text(toml(table))
        assert refused(modelled, folder / f"{name}_same.toml") == ""
    (folder / "same.toml").write_text(toml(STUDY))
    assert refused(read_study, folder / "same.toml") == ""
    assert len(read_study(folder / "same.toml").units) == 2 * 2 * 2 * 2 * 2 * 2


# What fuzzing and thinking like an attacker have found; none may come back
NESTED = "[" * 100_000 + "]" * 100_000


@pytest.fixture(autouse=True)
def soon(request):
    began = time.perf_counter()
    yield
    assert time.perf_counter() - began < 20.0 or "folder" in request.fixturenames  # random examples: a limit for each


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
    with pytest.raises(InputError, match=said) as refused:
        read(tmp_path / "odd.toml")
    assert len(str(refused.value)) < LONGEST


@pytest.mark.parametrize("read", [read_card, read_study])
@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "/dev/zero", "/dev/null/x", "."])
def test_names_that_no_table_has(read, name):
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


@pytest.mark.parametrize("suffix", [".mat", ".parquet", ".nc", "v7.mat"])
def test_small_files_that_claim_gigabytes(tmp_path, suffix, monkeypatch):
    """Ten channels of many zeros each: some kB compressed or never written."""
    count, rows = 10, 19_000_000 if suffix in (".nc", "v7.mat") else 190_000
    if rows < 1_000_000:  # zeros must be written there; the limit of all is the thing
        monkeypatch.setattr("bayes_aero.flight.text.MOST_VALUES_IN_ALL", 1_000_000)
    channels = (Channel("time", "s", "T", 1), *(Channel(f"c{i}", "1", f"C{i}", i) for i in range(2, count + 1)))
    path = tmp_path / f"big{suffix}"
    if suffix in (".nc", "v7.mat"):
        with h5py.File(path, "w", userblock_size=512 if suffix == "v7.mat" else 0) as file:
            for channel in channels:
                file.create_dataset(channel.heading, (rows,), "f8", chunks=(1_000_000,), compression="gzip")
    elif suffix == ".mat":
        zeros = np.zeros(rows)
        savemat(path, {channel.heading: zeros for channel in channels}, do_compression=True)
    else:
        zeros = pa.array(np.zeros(rows))
        pq.write_table(pa.table({channel.heading: zeros for channel in channels}), path)
    assert path.stat().st_size < 5_000_000
    with pytest.raises(InputError, match=r"more (values )?than"):
        read_record(path, channels)


@pytest.mark.parametrize("shape", [(10**12,), (10**12, 1), (2**62,)])
def test_an_hdf5_header_that_claims_more_than_there_is(tmp_path, shape):
    with h5py.File(tmp_path / "big.nc", "w") as file:
        for channel in CHANNELS:
            file.create_dataset(channel.heading, shape, "f8", chunks=(1000, *[1] * (len(shape) - 1)))
    with pytest.raises(InputError, match="claims"):
        read_record(tmp_path / "big.nc", CHANNELS)


@pytest.mark.parametrize(("piece", "times", "said"), [
    (b"1,", 50_000_000, "characters, more than"), (b"1,2\n", 6_000_000, "lines, more than"),  # one line of 100 MB
    (b"\r", 50_000_000, "lines, more than"), (b"T,ALCG\n" + b"9" * 150_000 + b",1\n1,2\n", 60, "column"),
])  # fmt: skip
def test_text_that_is_no_table(tmp_path, piece, times, said):
    path = tmp_path / "odd.csv"
    path.write_bytes(piece * times)
    with pytest.raises(InputError, match=said):
        read_record(path, CHANNELS)


def test_tables_far_beyond_any_record_are_refused(tmp_path):
    (tmp_path / "wide.csv").write_text("\n".join(",".join(f"{k}{i}" for i in range(25_000)) for k in ("c", "1", "2")))
    with pytest.raises(InputError, match="25000 columns, more than"):
        read_record(tmp_path / "wide.csv", CHANNELS)
    write_record(sound(60), tmp_path / "sound.csv", CHANNELS)
    with pytest.raises(InputError, match="makes more than"):
        read_record(tmp_path / "sound.csv", CHANNELS, resample=1e-12)
    text_of = shipped_cards()["attas"].read_text()
    assert "column = 1," in text_of
    (tmp_path / "far.toml").write_text(text_of.replace("column = 1,", "column = 1000000000000,", 1))
    with pytest.raises(InputError, match="no file has more than"):
        read_card(tmp_path / "far.toml")
    assert text.MOST_LINES > 20 * 200_000
    assert text.LONGEST_LINE > 2000 * 25


def test_many_columns_of_words_are_not_read_one_by_one(tmp_path, monkeypatch):
    calls = []
    read = text.read_cells
    monkeypatch.setattr(text, "read_cells", lambda *given: calls.append(1) or read(*given))
    monkeypatch.setattr("bayes_aero.flight.reading.PATIENCE", 3.0)
    rows = [
        ",".join(f"c{i}" for i in range(1000)) + ",t",
        *(",".join(["1"] * 500 + ["word"] * 500) + f",{0.1 * k}" for k in range(9)),
    ]
    (tmp_path / "words.csv").write_text("\n".join(rows))
    found = {column.label: column for column in read_raw(tmp_path / "words.csv").columns}
    assert found["t"].values is not None
    assert found["c7"].values is not None
    assert found["c700"].values is None
    assert len(calls) < 1100  # twice the words at most


@pytest.mark.parametrize("content", [NESTED, "[]", "null", '{"id": []}', "\xff"])
def test_damaged_json_in_a_results_folder(tmp_path, content):
    """Deep nesting raised RecursionError, a list AttributeError."""
    folder = tmp_path / "environment"
    folder.mkdir()
    (folder / "environment.json").write_text(content)
    store.write_environment(tmp_path)
    assert (folder / "environment.json").read_text() == content
    assert len(list(tmp_path.glob("environment-*/environment.json"))) == 1
    (tmp_path / unit.MANIFEST).write_text(content)
    one = unit.Unit("u", "identify", (), (), "attas", "attas", 0, None, None, ())
    assert unit.state_of(one, tmp_path).state == "damaged"
    for name in ("/etc/hostname", "../../../../../../etc/hostname", "a\0b", "x" * 300):
        made_from = unit.fingerprint(one)
        manifest = {"files": {name: ""}, "made_from": made_from, "state": "done"}
        unit.write_json(manifest, tmp_path / unit.MANIFEST)
        assert unit.state_of(one, tmp_path).state == "damaged"


@pytest.mark.parametrize(
    ("name", "source", "said"),
    [
        ("mine.py", b"import sys\nsys.exit(0)\n", "SystemExit"),
        ("mine.py", b"x = 1\n" * 300_000, "more than"),
        ("mine.py", b"\xff\xfe", "cannot be read"),
        *((name, b"", "no such file") for name in ("/dev/zero", "nowhere.py", ".")),
    ],
    ids=["exits", "long", "bytes", "device", "nowhere", "folder"],
)
def test_effect_files_that_are_none(tmp_path, name, source, said):
    if source:
        (tmp_path / name).write_bytes(source)
    with pytest.raises(InputError, match=said):
        own_effects([tmp_path / name])


@pytest.mark.parametrize(
    "name", ["..; rm -rf $(x) ü.csv", "con.x.csv", "NUL.csv", "..csv.csv", ".hidden.csv", "-rf.csv", "a" * 200 + ".csv"]
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
