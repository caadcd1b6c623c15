"""Which effects are candidates."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.effect import sized
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.chosen import lengths_of
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model


def test_stand_ins_are_no_candidates_but_serve_on_a_card(card, model, clean_records):
    flights = join(clean_records, card)
    stand_ins = {name for name, e in CATALOGUE.items() if not e.candidate and e.disturbance is None}
    assert stand_ins == {
        "alpha_drag", "speed_drag", "speed_lift", "speed_moment", "stabilizer_lift", "stabilizer_drag",
        "heading_delay", "pitot_position",
    }  # fmt: skip
    full = candidate_model(model, flights)
    assert len(full.candidates) > 20
    gusts = {name for name, effect in CATALOGUE.items() if effect.disturbance is not None}
    assert gusts == {"longitudinal_gust", "vertical_gust", "lateral_gust", "buffet"}  # random: a filter estimates them
    assert not (stand_ins | gusts) & ({e.name for e in full.model.effects} | set(full.not_testable))
    stated = Model.of([*card.effects, "speed_lift"], {"tau1": 0.0})
    full = candidate_model(stated, flights)
    assert "speed_lift" in full.base
    assert stand_ins & {e.name for e in full.model.effects} == {"speed_lift"}
    absent = Model.of([*card.effects, "speed_lift"], {"tau1": 0.0, "CLV": 0.0})  # written down, so asked for
    assert "speed_lift" in {e.name for e in candidate_model(absent, flights).candidates}


WAVE = np.sin(np.linspace(0.0, 9.0, 200))


@pytest.mark.parametrize(
    ("channels", "effect", "why"),
    [
        ({}, "thrust_moment", None),  # density and thrust stand still: T/(qbar S) moves with the airspeed
        ({}, "thrust_lift", None),
        ({"airspeed": 80.0}, "thrust_lift", "channel thrust, density, airspeed does not move in this record"),
        ({"airspeed": 80.0, "thrust": 9e3 + WAVE}, "thrust_moment", None),
        ({"thrust": 0.0}, "thrust_moment", "channel thrust, density does not move in this record"),
        ({"spoiler_left": 0.0, "spoiler_right": 0.1 * WAVE}, "spoiler_lift", None),
        ({"spoiler_left": 0.0, "spoiler_right": 0.1}, "spoiler_lift", "does not move"),
        ({"mach": 0.3}, "mach_lift", "channel mach does not move in this record"),  # the slope CLa says it already
        ({"canard": 0.1 * WAVE}, "canard_moment", None),
        ({"flap": 0.3}, "flap_lift", "channel flap does not move in this record"),
    ],
)
def test_an_effect_can_be_tested_where_what_it_acts_through_moves(card, channels, effect, why):
    base = {
        "alpha": 0.1 + 0.05 * WAVE, "q": 0.05 * WAVE, "airspeed": 80.0 + 5.0 * WAVE, "elevator": -0.05 * WAVE,
        "ax": 0.1 * WAVE, "az": -9.8 + WAVE, "p": 0.0, "r": 0.0, "density": 0.9, "thrust": 9e3,
    } | channels  # fmt: skip
    arrays = {name: np.broadcast_to(x, len(WAVE)) for name, x in base.items()}
    record = FlightRecord.from_arrays("run", np.arange(len(WAVE)) * 0.04, arrays)
    names = ["attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag"]
    full = candidate_model(Model.of(names), join([record], replace(card, sums={}, constants={})))
    assert (effect in {e.name for e in full.candidates}) == (why is None)
    assert why is None or why in full.not_testable[effect]


def test_sizes_worth_modelling_are_in_the_card_s_lengths(card, clean_records):
    """Per q c/2V Cmq is twice as large; with moments over half the span Clp is, too."""
    a = card.aircraft
    halved = replace(card, aircraft=replace(a, rate_length=a.chord / 2.0, lateral_length=a.half_span))
    worth = []
    for one in (card, halved):
        model = Model.from_card(replace(one, effects=tuple(name for name in one.effects if name != "pitch_damping")))
        full = candidate_model(model, join(clean_records, one))
        worth += [e.sizes["Cmq"] for e in full.candidates if e.name == "pitch_damping"]
    usual, twice = worth
    assert twice == pytest.approx([2.0 * x for x in usual])
    roll, lengths = CATALOGUE["roll_damping"], lengths_of(halved.aircraft)
    assert sized(roll, lengths).sizes["Clp"] == pytest.approx([2.0 * x for x in roll.sizes["Clp"]])
    assert sized(roll, lengths) is sized(roll, lengths), "a model is hashed by its effects"


@pytest.mark.parametrize("swing", [0.0, 0.05])
def test_nothing_is_scaled_or_delayed_that_shows_noise_alone(card, model, clean_records, swing):
    """Of lateral channels without a manoeuvre constants are left: a scale would be fitted to the noise of the vane."""
    rng, noisy = np.random.default_rng(5), []
    for record in clean_records:
        wave = swing * np.sin(0.7 * record.time)
        lateral = {n: wave + 0.001 * rng.standard_normal(record.n) for n in ("beta", "phi", "p", "r", "ay")}
        noisy.append(replace(record, channels={**record.channels, **lateral}))
    full = candidate_model(model, join(noisy, card))
    moved = {"sideslip_scale", "bank_angle_scale", "roll_rate_scale", "yaw_rate_scale", "sideslip_lift"}
    names = {e.name for e in full.candidates}
    assert {"sideslip_bias", "bank_angle_bias", "roll_rate_bias", "alpha_scale", "pitch_rate_scale"} <= names
    assert moved & names == (moved if swing else set())
    assert swing or full.not_testable["sideslip_scale"] == "channel beta shows nothing but noise in this record"


def test_every_effect_can_be_asked_where_all_channels_are_noise(card, model, clean_records):
    """No effect of the catalogue fails for want of what others make, whatever channel is noise."""
    rng = np.random.default_rng(6)
    level = {n: np.mean(x) for n, x in clean_records[0].channels.items()}
    calm = [
        replace(r, channels={n: x + 1e-3 * rng.standard_normal(r.n) for n, x in level.items()}) for r in clean_records
    ]
    for one in (model, Model.of(["attached_lift", "pitching_moment"])):
        assert "alpha_scale" in candidate_model(one, join(calm, card)).not_testable
