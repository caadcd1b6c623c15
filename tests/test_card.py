"""Cards: the shipped one, and one sentence for each thing that can be wrong with another."""

import copy
import math
import tomllib

import pytest

from bayes_aero.errors import InputError
from bayes_aero.flight.card import parse_card, read_card, shipped_cards
from bayes_aero.model.model import Model


@pytest.fixture(scope="module")
def table():
    return tomllib.loads(shipped_cards()["attas"].read_text())


def test_the_shipped_card_states_the_published_model_and_tau1_may_be_freed(card, table):
    model = Model.from_card(card)
    assert set(model.names) == {
        "CD0", "e", "CDX", "CL0", "CLa", "CLaM", "Cm0", "Cma", "Cmq", "Cmde", "CmX", "a1", "alpha_star", "tau2",
    }  # fmt: skip
    assert dict(model.fixed) == {"tau1": 0.0}
    assert float(card.aircraft.mass) == 17631.0
    changed = copy.deepcopy(table)
    changed["model"].pop("fixed")
    assert "tau1" in Model.from_card(parse_card(changed, "x", "x.toml")).names


def edit(path, value):
    def change(table):
        node = table
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (edit(["aircaft"], {}), "aircraft"),
        (edit(["aircraft", "mass"], "17631 m"), "mass"),
        (edit(["aircraft", "mass"], "-1 kg"), "positive"),
        (edit(["channels", "alpha", "colum"], 3), "column"),
        (edit(["channels", "alpha"], {"column": 3}), "unit"),
        (edit(["channels", "alpha"], {"column": 0, "unit": "deg"}), "counted from 1"),
        (edit(["model", "effects"], []), "effects"),
        (edit(["model", "effects"], ["attached_lft"]), "attached_lift"),
        (edit(["model", "fixed"], {"tau9": 0.0}), "tau9"),
        (edit(["parameters", "CL0"], {"start": "high"}), "number"),
        (edit(["parameters", "CL0"], {"start": 3.0, "bounds": [0.0, 1.0]}), "outside its bounds"),
        (edit(["parameters", "CL0"], {"prior": {"family": "normal", "location": 0.0, "scale": 0.0}}), "positive"),
        (edit(["parameters", "CL0"], {"prior": {"family": "cauchy", "location": 0.0, "scale": 1.0}}), "cauchy"),
        (edit(["parameters", "CLX"], {"start": 0.0}), "CLX"),
        (edit(["sums", "thrust"], ["thrust_middle"]), "thrust_middle"),
        (edit(["sensors", "ax"], "-1 m/s^2"), "negative"),
        (edit(["output_biases"], {"theta": "0 deg"}), r"\[output_biases\] theta .* positive"),
        (edit(["output_biases"], {"tetha": "1 deg"}), "tetha"),
    ],
)
def test_a_wrong_card_is_one_sentence(table, change, words):
    changed = copy.deepcopy(table)
    change(changed)
    with pytest.raises(InputError, match=words):
        Model.from_card(parse_card(changed, "x", "x.toml"))


def test_unknown_names_and_unowned_terms_are_told_with_a_remedy(table):
    with pytest.raises(InputError, match="attas"):
        read_card("attass")
    changed = copy.deepcopy(table)
    changed["model"]["effects"].remove("attached_lift")
    with pytest.raises(InputError, match=r"^card mine, \[model\]: .* add attached_lift to the effects$"):
        Model.from_card(parse_card(changed, "mine", "mine.toml"))


def test_tolerances_come_from_the_card_or_from_the_simulator_standard(tmp_path):
    text = shipped_cards()["attas"].read_text()
    card = read_card("attas")
    assert card.tolerances["airspeed"].value == pytest.approx(3 * 1852 / 3600)
    assert card.tolerances["theta"].value == pytest.approx(math.radians(2.0))
    assert "Part 60" in card.tolerances["q"].source
    path = tmp_path / "own.toml"
    path.write_text(text.replace('airspeed = "3 kt"', 'airspeed = "-3 kt"'))
    with pytest.raises(InputError, match="airspeed"):
        read_card(path)
    begin, end = text.index("[tolerances]"), text.index("[gp]")
    path.write_text(text[:begin] + text[end:])
    assert read_card(path).tolerances["alpha"].value == pytest.approx(math.radians(2.0))
