"""Effects and terms hidden in records, some of which no catalogue has: what is recorded, what is found, its size."""

from dataclasses import replace

import numpy as np
import pytest
import unlisted_terms
import wing_first
from calling import validated
from injected_effects import injected

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


@pytest.fixture(scope="module")
def record(card):
    return simulate_stall(0, card=card)


def test_a_faulty_sensor_records_the_error_and_nothing_else_and_thrust_stays_shared(record, card):
    (faulty,) = injected([record], {"pitch_rate_bias": {"pitch_rate_bias": 0.01}}, card, Cmde=-0.7)
    np.testing.assert_allclose(np.asarray(faulty["q"]) - np.asarray(record["q"]), 0.01, atol=1e-9)
    for name in ("alpha", "ax", "az", "elevator", "thrust_left", "airspeed"):
        np.testing.assert_allclose(faulty[name], record[name], rtol=1e-9, atol=1e-9)
    assert faulty.sha256 != record.sha256
    (faulty,) = injected([record], {"thrust_scale": {"thrust_scale": 0.25}}, card, Cmde=-0.7)
    for name in ("thrust_left", "thrust_right"):  # true = recorded x 1.25
        np.testing.assert_allclose(np.asarray(faulty[name]) * 1.25, record[name], rtol=1e-6)


def test_the_elevator_holds_an_injected_moment_and_alpha_dot_is_made_from_the_record(record, card):
    (held,) = injected([record], {"thrust_moment": {"thrust_arm": 0.5}}, card, Cmde=-0.7)
    a, thrust = card.aircraft, np.asarray(record["thrust_left"]) + np.asarray(record["thrust_right"])
    pressure = 0.5 * np.asarray(record["density"]) * np.asarray(record["airspeed"]) ** 2
    moment = 0.5 * thrust / (pressure * a.wing_area * a.chord)
    change = np.asarray(held["elevator"]) - np.asarray(record["elevator"])
    # Density and airspeed are smoothed before coefficients are formed.
    np.testing.assert_allclose(-0.7 * change + moment, 0.0, atol=0.02 * moment.max())
    (held,) = injected([record], {"alpha_dot_moment": {"Cmadot": -3.0}}, card, Cmde=-0.7)
    assert np.std(np.asarray(held["elevator"]) - np.asarray(record["elevator"])) > 1e-4


def test_what_cannot_be_injected_is_refused(record, card):
    with pytest.raises(InputError, match="more than the pitching moment"):
        injected([record], {"thrust_lift": {"thrust_lift": 0.3}}, card, Cmde=-0.7)
    with pytest.raises(InputError, match="rests on parameters of other effects"):
        injected([record], {"drag_offset": {"CLmin": 0.1}}, card, Cmde=-0.7)
    with pytest.raises(InputError, match="depends on separation"):
        injected([record], {"separated_damping": {"CmqX": 0.3}}, card, Cmde=-0.7)


@pytest.mark.verify
def test_sensor_errors_are_found_on_top_of_what_the_real_records_contain(attas_paths, card):
    records = [read_record(path, card.channels) for path in attas_paths]
    rng = np.random.default_rng(90)
    hidden = {"pitch_rate_bias": rng.uniform(0.004, 0.012), "accel_z_bias": rng.uniform(0.2, 0.6)}
    hidden["alpha_scale"] = rng.uniform(0.05, 0.1)
    faulty = injected(records, {name: {name: size} for name, size in hidden.items()}, card, Cmde=-0.7)
    before, after = (
        {
            p: s
            for c in diagnose(r, card, settings=DiagnosisSettings(gains=False)).causes
            for p, s in c.parameters.items()
        }
        for r in (records, faulty)
    )
    for name, size in hidden.items():
        assert name in after, name
        moved = after[name].mean - (before[name].mean if name in before else 0.0)
        assert moved == pytest.approx(size, abs=0.15 * abs(size) + 2.0 * after[name].sd), name


TERM_SEED = 107


def flown(values):
    beyond = Beyond((unlisted_terms.UNLISTED,), lambda _: values)
    return hidden_records({}, seed=TERM_SEED, noise="ar1", seconds=90.0, beyond=beyond)


@pytest.mark.verify
def test_a_hidden_term_is_found_written_and_then_named_as_a_cause(tmp_path):
    coefficient, name, values = unlisted_terms.draw(np.random.default_rng([TERM_SEED, 31]))
    true, records, card = values["unlisted_product"], flown(values), read_card("attas")
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
    rng = np.random.default_rng([501, 31])
    noise, (coefficient, name, values) = str(rng.choice(["white", "ar1", "buffet"])), unlisted_terms.draw(rng)
    assert (noise, coefficient, name) == ("white", "Cm", "exp")
    beyond = Beyond((unlisted_terms.UNLISTED,), lambda _: values)
    flown = hidden_records({}, seed=501, noise=noise, seconds=90.0, beyond=beyond)
    records = [unlisted_terms.without_accelerometers(r) for r in flown]
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


@pytest.mark.recovery
def test_a_flight_that_breaks_down_after_its_record_leaves_the_record_whole():
    """Simulations are longer than what is kept; filters had spread what was no number there over all channels."""
    rng = np.random.default_rng([703, 31])
    rng.choice(3)  # of the noise
    for _ in range(20):
        coefficient, name, values = unlisted_terms.draw(rng)
        if "unlisted_product" in values:
            break
    assert (coefficient, name) == ("CL", "elevator CT^2")
    beyond = Beyond((unlisted_terms.UNLISTED,), lambda _: values)
    for record in hidden_records({}, seed=703, noise="ar1", seconds=90.0, beyond=beyond):
        assert all(np.all(np.isfinite(x)) for x in record.channels.values())


RECORDS = ("rudder", "stall_in_bank")


def alone(found, name, size, most):
    """What is told of a diagnosis whose one cause, without rivals, has this size to `most` of it."""
    said = wing_first.told(found, 0.0)
    assert list(said["causes"]) == [name]
    assert said["ambiguous"] == {name: []}
    ((mean, sd),) = said["causes"][name].values()
    assert abs(mean - size) < 1.96 * sd
    assert sd < most * abs(size)
    return said


@pytest.mark.verify
def test_a_wing_that_stalls_first_is_found_alone_and_sized():
    """No aileron offset, centre of gravity aside, uneven engines or vane: those are candidates of the same record."""
    plane, records, size = wing_first.flown(0)
    chosen = [record for record in records if record.name in RECORDS]
    found = diagnose(chosen, wing_first.card_of(plane), settings=DiagnosisSettings(gains=False, process_noise=False))
    assert alone(found, "wing_asymmetry", size, 0.01)["unexplained"] == []
    rivals = {*wing_first.CAUSES, *wing_first.NAMED.values()} - {"wing_asymmetry", *wing_first.NAMED}
    assert rivals <= {e.name for e in found.aerodynamics.state.full.candidates}


@pytest.mark.verify
def test_uneven_engines_are_told_from_their_rivals_by_the_manoeuvres_that_are_proposed():
    """The rudder that holds them is at rest while ailerons move: its derivative, free on the card, takes them up."""
    plane, records, size = wing_first.flown(3)
    first, then = ([r for r in records if r.name in names] for names in (("aileron",), ("aileron", "stall_in_bank")))
    found = diagnose(first, wing_first.card_of(plane), settings=DiagnosisSettings(gains=False, process_noise=False))
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
    found = diagnose(then, wing_first.card_of(plane), settings=DiagnosisSettings(gains=False, process_noise=False))
    assert found.verdict is Verdict.EXPLAINED
    assert found.absorbed == ()
    alone(found, "thrust_asymmetry", size, 0.1)


def test_the_table_counts_what_was_named(capsys):
    def row(hidden, causes, ambiguous=(), unexplained=(), size=1.0):
        told = {name: {"x": [mean, 0.1]} for name, mean in causes.items()}
        among = {name: list(ambiguous) for name in causes}
        return {
            "seed": 0, "hidden": hidden, "size": size, "causes": told, "ambiguous": among,
            "unexplained": list(unexplained), "manoeuvres": [],
        }  # fmt: skip

    wing_first.report(
        [
            row("wing_asymmetry", {"wing_asymmetry": 1.1}),
            row("wing_asymmetry", {"roll_offset": 1.0, "wing_asymmetry": 1.3}),
            row("wing_asymmetry", {"roll_offset": 1.0}, ["wing_asymmetry"]),
            row("aileron_offset", {"roll_offset": 0.9}, ["lateral_cg_shift"]),
            row(None, {}),
            row(None, {}, unexplained=[["Cl", "p"]]),
        ]
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["wing_asymmetry", "3", "1", "1", "1", "1", "of", "2"]
    assert lines[2].split() == ["aileron_offset", "1", "1", "0", "1", "1", "of", "1"]
    assert lines[6] == "nothing hidden: silent 1 of 2"
