"""A user's effect in a Python file that the card names: read, used, trusted no further than the card, and found."""

import numpy as np
import pytest
from out_of_catalogue import unknown

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card, shipped_cards
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.model.own_effects import own_effects
from bayes_aero.simulate.injection import hidden_flights, hidden_records

SOURCE = '''
"""A pitching moment from bank angle."""

import jax.numpy as jnp

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += CmB sin(phi)."""
    return {"Cm": v["CmB"] * jnp.sin(s["phi"])}


EFFECT = Effect(
    name="bank_pitching",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Bank pitches the aircraft.",
    parameters=(Parameter("CmB", "1", 0.0, 0.0, "slope", Prior("normal", 0.0, 0.1)),),
    channels=("phi",),
    increments=increments,
    example=Example({"CmB": 0.1}, {"phi": 0.5}, {"Cm": 0.0479}, "0.1 sin 0.5"),
    source="made up",
    sizes={"CmB": (0.005, 0.1)},
)
'''


def own_card(folder, source=SOURCE, active=False):
    """The ATTAS card in another folder, naming a file of effects."""
    (folder / "mine.py").write_text(source)
    effects = 'effects = ["bank_pitching",' if active else "effects = ["
    text = shipped_cards()["attas"].read_text().replace("effects = [", f'effect_files = ["mine.py"]\n{effects}', 1)
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def test_a_card_takes_an_effect_from_its_own_folder(tmp_path):
    card = read_card(own_card(tmp_path, active=True))
    model = Model.from_card(card)
    assert "CmB" in model.names
    assert model.effects == Model.from_card(card).effects  # the same objects: nothing compiles anew


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("1/0", "does not run: ZeroDivisionError"),
        ("x = (", "does not run: SyntaxError"),
        ("x = 1", "defines no Effect"),
        (SOURCE.replace('"bank_pitching"', '"thrust_lift"'), "the name thrust_lift is taken"),
    ],
)
def test_a_file_that_is_no_effect_is_said_in_a_sentence(tmp_path, source, said):
    with pytest.raises(InputError, match=said):
        Model.from_card(read_card(own_card(tmp_path, source)))


def test_a_file_that_is_not_there_is_said(tmp_path):
    card = read_card(own_card(tmp_path))
    (tmp_path / "mine.py").unlink()
    with pytest.raises(InputError, match=r"mine\.py cannot be read"):
        Model.from_card(card)


def test_it_stands_for_election(tmp_path):
    card, records = read_card(own_card(tmp_path)), hidden_records({}, seed=0, manoeuvres=1, seconds=90.0)
    own = tuple(own_effects(card.effect_files).values())
    field = candidate_model(Model.from_card(card), join(records, card), own)
    assert "bank_pitching" in {e.name for e in field.candidates}
    assert "CmB" in field.model.names


@pytest.mark.verify
def test_diagnosis_names_the_users_effect_and_calls_it_unexplained_without(tmp_path, card):
    seed = int(np.random.default_rng(5150).integers(1_000_000))
    flights = hidden_flights({}, seed=seed, noise="ar1", seconds=90.0, beyond=unknown("bank_moment"))
    records, size = [f.record for f in flights], flights[0].values["unknown_bank"]
    found = diagnose(records, read_card(own_card(tmp_path)), seed=seed, gains_wanted=False)
    assert [c.name for c in found.causes] == ["bank_pitching"]
    assert found.causes[0].parameters["CmB"].mean == pytest.approx(size, rel=0.1)
    assert not found.unknown
    without = diagnose(records, card, seed=seed, gains_wanted=False)
    assert without.unknown[0].channel.startswith("phi")
