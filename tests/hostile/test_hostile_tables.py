"""Whatever a card or a study says, it is read or refused in one sentence, soon, without a warning."""

from __future__ import annotations

import shutil
import tomllib
import warnings
from pathlib import Path

import pytest
from fuzzing import examples
from hypothesis import given
from hypothesis import strategies as st
from linear_cards import SHORT_PERIOD
from mutations import changes, mutated, toml

from bayes_aero.errors import LONGEST, InputError
from bayes_aero.flight.card.card import read_card, shipped_cards
from bayes_aero.model.model import Model
from bayes_aero.study.study import read_study

CARDS = {
    "attas": tomllib.loads(shipped_cards()["attas"].read_text(encoding="utf-8")),
    "linear": tomllib.loads(SHORT_PERIOD),
}
STUDY = {
    "title": "a study",
    "task": "identify",
    "records": ["flights/*.csv", "flights/a.csv"],
    "one_by_one": True,
    "cards": ["attas", "mine.toml"],
    "seeds": [0, 1],
    "splits": ["random", "block"],
    "noise": ["white", "ar1"],
    "effects": [[], ["alpha_squared_moment"]],
    "options": {"gp": False, "figures": False, "resample": 0.04},
}


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
