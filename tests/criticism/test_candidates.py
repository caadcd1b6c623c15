"""Which effects stand for election."""

from bayes_aero.criticism.candidates import field_of
from bayes_aero.effects import CATALOGUE
from bayes_aero.model.flights import join
from bayes_aero.model.model import Model


def test_stand_ins_are_no_candidates_but_serve_on_a_card(card, model, clean_records):
    flights = join(clean_records, card)
    stand_ins = {name for name, effect in CATALOGUE.items() if not effect.candidate}
    assert stand_ins == {"alpha_drag", "speed_drag", "speed_lift", "speed_moment"}
    field = field_of(model, flights)
    assert len(field.candidates) > 20
    assert not stand_ins & ({e.name for e in field.model.effects} | set(field.not_testable))
    stated = Model.of([*card.effects, "speed_lift"], {"tau1": 0.0})
    field = field_of(stated, flights)
    assert "speed_lift" in field.base
    assert stand_ins & {e.name for e in field.model.effects} == {"speed_lift"}
    absent = Model.of([*card.effects, "speed_lift"], {"tau1": 0.0, "CLV": 0.0})  # written down, so asked for
    assert "speed_lift" in {e.name for e in field_of(absent, flights).candidates}
