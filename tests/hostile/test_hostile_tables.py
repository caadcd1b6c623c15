"""Whatever a card or a study says, it is read or refused in one sentence, soon, without a warning."""

import copy
import json
import math
import shutil
import tomllib
import warnings
from pathlib import Path
from typing import Any

import pytest
from fuzzing import examples
from hypothesis import given
from hypothesis import strategies as st
from linear_cards import SHORT_PERIOD

from bayes_aero.errors import LONGEST, InputError
from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.model.model import Model
from bayes_aero.study.study import read_study

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


def toml(value: Any) -> str:
    """A document with one inline value a line; whatever TOML cannot say stands there all the same."""
    return "".join(f"{_key(key)} = {_inline(inner)}\n" for key, inner in value.items())


def _key(key: Any) -> str:
    return json.dumps(str(key), ensure_ascii=False).replace("\x7f", "\\u007f")


def _inline(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return hex(value) if value > 2**70 else str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        return _key(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return "{" + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + "}"


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


@pytest.mark.parametrize("name", CARDS)
def test_changed_cards(folder, name):
    @examples(200)
    @given(changes())
    def run(wrong):
        path = folder / "card.toml"
        path.write_text(toml(mutated(CARDS[name], wrong)), encoding="utf-8", errors="surrogatepass")
        refused(modelled, path)

    run()


def test_changed_studies(folder):
    @examples(100)
    @given(changes())
    def run(wrong):
        path = folder / "study.toml"
        path.write_text(toml(mutated(STUDY, wrong)), encoding="utf-8", errors="surrogatepass")
        refused(read_study, path)

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
