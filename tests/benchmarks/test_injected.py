"""Effects and terms hidden in records, some of which no catalogue has: what is recorded, what is found, its size."""

from dataclasses import replace

import numpy as np
import pytest
import unlisted_terms
from calling import validated
from injected_effects import injected
from lateral_effects import CAUSES, MODEL, NAMED, card_of
from lateral_effects import flown as flown_wing
from studies import without_accelerometers

from bayes_aero.diagnosis import selection_state
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record
from bayes_aero.jobs.diagnose import diagnose_records, proposed_points
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.jobs.preparing import write_effects
from bayes_aero.model.model import own_effects
from bayes_aero.simulate.demo import simulate_stall
from bayes_aero.simulate.injection import Beyond, hidden_records

TERM_SEED = 107


@pytest.fixture(scope="module")
def record(card):
    return simulate_stall(0, card=card)


def test_what_is_injected_is_recorded_and_nothing_else_and_thrust_stays_shared(record, card):
    def put(**effects):
        (faulty,) = injected([record], effects, card, Cmde=-0.7)
        return {name: np.asarray(faulty[name]) for name in faulty.channels}, faulty.sha256

    before = {name: np.asarray(record[name]) for name in record.channels}
    faulty, sha256 = put(pitch_rate_bias={"pitch_rate_bias": 0.01})
    assert sha256 != record.sha256
    for name in ("q", "alpha", "ax", "az", "elevator", "thrust_left", "airspeed"):
        np.testing.assert_allclose(faulty[name], before[name] + 0.01 * (name == "q"), rtol=1e-9, atol=1e-9)
    faulty, _ = put(thrust_scale={"thrust_scale": 0.25})
    for name in ("thrust_left", "thrust_right"):  # true = recorded x 1.25
        np.testing.assert_allclose(faulty[name] * 1.25, before[name], rtol=1e-6)

    held, _ = put(thrust_moment={"thrust_arm": 0.5})  # by the elevator
    a, thrust = card.aircraft, before["thrust_left"] + before["thrust_right"]
    moment = 0.5 * thrust / (0.5 * before["density"] * before["airspeed"] ** 2 * a.wing_area * a.chord)
    # Density and airspeed are smoothed before coefficients are formed.
    np.testing.assert_allclose(0.7 * (held["elevator"] - before["elevator"]), moment, atol=0.02 * moment.max())
    held, _ = put(alpha_dot_moment={"Cmadot": -3.0})  # alpha-dot is made from the record
    assert np.std(held["elevator"] - before["elevator"]) > 1e-4


@pytest.mark.parametrize(("name", "values", "words"), [
    ("thrust_lift", {"thrust_lift": 0.3}, "more than the pitching moment"),
    ("drag_offset", {"CLmin": 0.1}, "rests on parameters of other effects"),
    ("separated_damping", {"CmqX": 0.3}, "depends on separation"),
])  # fmt: skip
def test_what_cannot_be_injected_is_refused(record, card, name, values, words):
    with pytest.raises(InputError, match=words):
        injected([record], {name: values}, card, Cmde=-0.7)


@pytest.mark.verify
def test_sensor_errors_are_found_on_top_of_what_the_real_records_contain(attas_paths, card):
    records = [read_record(path, card.channels) for path in attas_paths]
    rng, settings = np.random.default_rng(90), DiagnosisSettings(gains=False)
    hidden = {"pitch_rate_bias": rng.uniform(0.004, 0.012), "accel_z_bias": rng.uniform(0.2, 0.6)}
    hidden["alpha_scale"] = rng.uniform(0.05, 0.1)
    faulty = injected(records, {name: {name: size} for name, size in hidden.items()}, card, Cmde=-0.7)
    causes = [diagnose(r, card, settings=settings).causes for r in (records, faulty)]
    before, after = ({p: s for c in found for p, s in c.parameters.items()} for found in causes)
    for name, size in hidden.items():
        assert name in after, name
        moved = after[name].mean - (before[name].mean if name in before else 0.0)
        assert moved == pytest.approx(size, abs=0.15 * abs(size) + 2.0 * after[name].sd), name


@pytest.mark.verify
def test_a_hidden_term_is_found_written_and_then_named_as_a_cause(tmp_path):
    coefficient, name, values = unlisted_terms.draw(np.random.default_rng([TERM_SEED, 31]))
    true, card = values["unlisted_product"], read_card("attas")
    beyond = Beyond((unlisted_terms.UNLISTED,), lambda _: values)
    records = hidden_records({}, seed=TERM_SEED, noise="ar1", seconds=90.0, beyond=beyond)
    found = diagnose(records, card, seed=TERM_SEED)
    assert found.failures == ()
    assert found.verdict is Verdict.UNEXPLAINED
    (term,) = found.terms
    assert (term.coefficient, term.term.name) == (coefficient, name)
    mean, sd = term.size
    assert abs(mean - true) < 1.96 * sd
    assert sd < 0.1 * abs(true)

    path = tmp_path / "found.py"
    write_effects(found.terms, [r.name for r in records], path)
    again = diagnose(
        records, replace(card, effect_files=(path,)), seed=TERM_SEED, settings=DiagnosisSettings(gains=False)
    )
    assert again.verdict is Verdict.EXPLAINED
    (cause,) = again.causes
    ((size,),) = [list(cause.parameters.values())]
    assert abs(size.mean - true) < 1.96 * size.sd


@pytest.mark.verify
def test_without_accelerometers_a_bump_is_found_in_flight_and_written(tmp_path, monkeypatch):
    """Of few effects, which compile sooner. The bump of Cm over alpha has a width of 0.03 rad."""
    few = ("thrust_moment", "pitch_rate_lift", "mach_drag", "alpha_bias")
    monkeypatch.setattr(selection_state, "CATALOGUE", {name: CATALOGUE[name] for name in few})
    (coefficient, name, _), noise, flown = unlisted_terms.in_stalls(501, False)
    assert (noise, coefficient, name) == ("white", "Cm", "exp")
    records = [without_accelerometers(r) for r in flown]
    told = diagnose_records(records, read_card("attas"), DiagnoseOptions(), out=tmp_path)
    content = validated(tmp_path / "diagnosis.json", "diagnosis")
    assert content["failures"] == []
    assert content["verdict"] == "unexplained"
    assert content["tested"]["rests_on"] == "trajectories"
    assert "exp(" in content["terms"][0]["term"]
    assert (tmp_path / "terms.csv").read_text().count("\n") == 1 + len(content["terms"])
    assert (tmp_path / "report.html").stat().st_size > 10_000
    path = tmp_path / "found.py"
    assert "effect" in write_effects(told.diagnosis.terms, ["run"], path)
    assert len(own_effects([path])) == len(content["terms"])


def alone(found, name, size, most):
    """One cause, without rivals, of this size to `most` of it."""
    (cause,) = found.causes
    assert (cause.name, tuple(cause.ambiguous_with)) == (name, ())
    (found_size,) = cause.parameters.values()
    assert abs(found_size.mean - size) < 1.96 * found_size.sd
    assert found_size.sd < most * abs(size)


def diagnosed(plane, records, *names):
    card, settings = card_of(plane, MODEL), DiagnosisSettings(gains=False, process_noise=False)
    return diagnose([record for record in records if record.name in names], card, settings=settings)


@pytest.mark.verify
def test_a_wing_that_stalls_first_is_found_alone_and_sized():
    """No aileron offset, centre of gravity aside, uneven engines or vane: those are candidates of the same record."""
    plane, records, size = flown_wing(0)
    found = diagnosed(plane, records, "rudder", "stall_in_bank")
    alone(found, "wing_asymmetry", size, 0.01)
    assert tuple(found.unknown) == ()
    rivals = {NAMED.get(cause, cause) for cause in CAUSES} - {"wing_asymmetry", "roll_offset"}
    assert {*rivals, "aileron_offset"} <= {e.name for e in found.aerodynamics.state.full.candidates}


@pytest.mark.verify
def test_uneven_engines_are_told_from_their_rivals_by_the_manoeuvres_that_are_proposed():
    """The rudder that holds them is at rest while ailerons move: its derivative, free on the card, takes them up."""
    plane, records, size = flown_wing(3)
    found = diagnosed(plane, records, "aileron")
    assert found.verdict is Verdict.UNDECIDED
    assert found.causes == ()
    (taken_up,) = found.absorbed
    assert taken_up.parameter == "Cndr"
    absorbed = taken_up.sizes["thrust_asymmetry"]
    assert abs(absorbed.mean - size) < absorbed.sd
    proposed = proposed_points(found)
    (question,) = proposed["questions"]
    assert {"rudder_yaw", "thrust_asymmetry", "yaw_offset"} <= set(question["effects"])
    assert proposed["points"][-1]["standard_errors"][0] >= question["enough"]
    found = diagnosed(plane, records, "aileron", "stall_in_bank")
    assert found.verdict is Verdict.EXPLAINED
    assert found.absorbed == ()
    alone(found, "thrust_asymmetry", size, 0.1)
