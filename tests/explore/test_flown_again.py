"""Flown again: by the result's values as `fly` wrote it, by others as the package simulates the card's model."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from bayes_aero.diagnosis.trajectories.histories import fly_given
from bayes_aero.errors import InputError
from bayes_aero.explore.opened import Choice, addable, open_result, shown_effects
from bayes_aero.explore.simulator import Simulator
from bayes_aero.flight.reading import read_record
from bayes_aero.inference.mle import fit_mle
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.aircraft import FLIGHT


def agree(found, expected):
    for name, y in expected.items():
        np.testing.assert_allclose(found[name], y, rtol=1e-9, atol=1e-9 * np.ptp(y), err_msg=name)


def test_the_result_is_the_one_that_fly_wrote(results, simulator):
    with xr.open_datatree(results.flown / "histories.nc", engine="h5netcdf") as tree:
        written = tree["trajectories_fitted"].to_dataset().load()
    now = simulator.fly(0, Choice())
    assert now.inside.all()
    for name in simulator.outputs:
        y = np.asarray(written[f"{name}_fitted"])
        np.testing.assert_allclose(now.simulated[name], y, rtol=1e-6, atol=1e-6 * np.ptp(y), err_msg=name)


def test_other_values_and_effects_fly_as_the_package_does(packaged, simulator, model, card):
    agree(simulator.fly(0, Choice({"CLa": 3.9, "Cmde": -1.1})).simulated, packaged(model, CLa=3.9, Cmde=-1.1))
    kept = tuple(e for e in card.effects if e != "separated_moment")
    without = Model.of(kept, card.fixed)
    agree(simulator.fly(0, Choice(off=frozenset({"separated_moment"}))).simulated, packaged(without))
    wider = model.extended("mass_scale")
    heavy = simulator.fly(0, Choice({"mass_scale": 1.04}, added=("mass_scale",)))
    agree(heavy.simulated, packaged(wider, mass_scale=1.04))


def test_a_lag_can_be_added_and_switched_off(packaged, simulator, card):
    """Off it is exactly absent, though a lag of zero would leave a fast state."""
    fixed = {name: x for name, x in card.fixed.items() if name != "tau1"}
    lagged = Model.of(card.effects, fixed)
    added = ("separation_lag",)
    agree(simulator.fly(0, Choice({"tau1": 9.0}, added=added)).simulated, packaged(lagged, tau1=9.0))
    off = simulator.fly(0, Choice({"tau1": 9.0}, frozenset(added), added)).simulated
    agree(off, simulator.fly(0, Choice()).simulated)


def test_effects_are_those_with_parameters_that_act_and_what_is_not_flown_is_said(simulator, model):
    shown = {e.name for e in shown_effects(model)}
    assert "attached_lift" in shown
    assert shown.isdisjoint({"kirchhoff_lift", "separation_lag"})  # without parameters; fixed at neutral by the card
    more = {e.name for e in addable(model, tuple(simulator.flights.channels))}
    assert {"separation_lag", "mass_scale"} <= more
    assert more.isdisjoint({"attached_lift", "vertical_gusts", "longitudinal_gusts"})
    opened = simulator.opened
    assert opened.limits == ()
    noisy = {"converged": True, "gain": 5.0}
    (said,) = replace(opened, told={**opened.told, "process_noise": noisy}).limits
    assert "gusts and the noise of its states are not flown here" in said


def test_coefficients_are_those_of_the_record_and_the_model(results, simulator, card, model):
    """Formed by the observations of identify, modelled by the fit that identify makes of them."""
    record = read_record(results.folder / "stall.csv", card.channels)
    seen = observe([record], card, model)
    found = fit_mle(model, seen, seed=0)
    values = dict(zip(found.names, map(float, found.estimate), strict=True))
    now = simulator.fly(0, Choice(values))
    predicted = np.asarray(model.predicted(found.estimate, seen.signals, seen.aircraft))
    for c, name in enumerate(model.coefficients):
        span = np.ptp(predicted[:, c])
        assert np.sqrt(np.mean((now.coefficients[name] - predicted[:, c]) ** 2)) < 0.01 * span


def test_draws_have_the_covariance_of_the_fit(simulator, monkeypatch):
    """CL of 400 draws: standard deviation as by the law of error propagation, within four of its own errors (15 %).
    A tenth of the standard errors, because a stall is not linear over the whole."""
    told = dict(simulator.opened.told)
    told["covariance"] = (0.01 * np.array(told["covariance"])).tolist()
    monkeypatch.setitem(simulator.opened.told, "covariance", told["covariance"])
    origin, fan = simulator.fan(0, count=400, seed=1)
    assert origin.startswith("normal distribution of the estimates")
    slopes = []
    for name, p in told["parameters"].items():
        h = 0.01 * p["sd_corrected"]
        up, down = (simulator.fly(0, Choice({name: p["estimate"] + x})).coefficients["CL"] for x in (h, -h))
        slopes.append((up - down) / (2.0 * h))
    expected = np.sqrt(np.einsum("in,ij,jn->n", slopes, np.array(told["covariance"]), slopes))
    np.testing.assert_allclose(np.std(fan["CL"], axis=0), expected, rtol=0.15)


def test_records_that_moved_are_named_with_the_way_to_mend_it(results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    moved, elsewhere = tmp_path / "a" / "b" / "flown", tmp_path / "records"
    shutil.copytree(results.flown, moved)
    with pytest.raises(InputError, match=r"record stall\.csv .* give its folder with --records"):
        open_result(str(moved))
    elsewhere.mkdir()
    shutil.copy(results.folder / "stall.csv", elsewhere)
    assert [r.name for r in open_result(str(moved), None, [elsewhere]).records] == ["stall"]
    text = (elsewhere / "stall.csv").read_text()
    (elsewhere / "stall.csv").write_text(text + "\n")  # the same samples
    assert [r.name for r in open_result(str(moved), None, [elsewhere]).records] == ["stall"]
    (elsewhere / "stall.csv").write_text("\n".join(text.splitlines()[:-1]))
    with pytest.raises(InputError, match="has changed since"):
        open_result(str(moved), None, [elsewhere])


def test_every_manoeuvre_of_identify_flies_from_its_measured_state(results, card, model):
    """As the package flies all of them together."""
    simulator = Simulator(open_result(str(results.identified)))
    assert simulator.opened.departures == {}
    assert simulator.manoeuvres == ("stall", "second")
    records = [read_record(results.folder / f"{name}.csv", card.channels) for name in simulator.manoeuvres]
    flights, _ = despiked(join(records, card, FLIGHT))
    paths = fly_given(flights, model, simulator.opened.identified.values, {})
    assert len(paths[0].time) > len(paths[1].time)
    for k, path in enumerate(paths):
        now = simulator.fly(k, Choice())
        agree(now.simulated, path.simulated)
        np.testing.assert_array_equal(simulator.time(k), path.time)
        assert {len(y) for y in (*now.coefficients.values(), *now.formed.values())} == {len(path.time)}
