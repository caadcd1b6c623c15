"""Flown again: by the result's values as `fly` wrote it, by others as the package simulates the card's model."""

from __future__ import annotations

import json

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.errors import InputError
from bayes_aero.explore.choice import Choice, addable, shown_effects
from bayes_aero.explore.opened import open_result
from bayes_aero.explore.simulator import Simulator
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe


def packaged(results, card, model, **changed):
    """Outputs (n, c) of a model's simulation by the package, from the initial state that `fly` fitted."""
    told = json.loads((results.flown / "trajectories.json").read_text())
    flights, _ = despiked(join([read_record(results.folder / "stall.csv", card.channels)], card, FLIGHT))
    dynamics = aircraft_dynamics(model, flights)
    whole = segments(flights, dynamics)
    fitted = {name: p["estimate"] for name, p in told["parameters"].items()} | changed
    (state,) = told["initial_states"].values()
    away = np.array([[state.get(name, {"departure": 0.0})["departure"] for name in dynamics.start]])
    theta = jnp.array([fitted.get(p.name, p.start) for p in dynamics.free])
    found = simulate(whole, theta, jnp.array(away))
    return dict(zip(whole.outputs, np.asarray(found.measured - found.residual)[0].T, strict=True))


def agree(found, expected):
    for name, y in expected.items():
        np.testing.assert_allclose(found[name], y, rtol=1e-9, atol=1e-9 * np.ptp(y), err_msg=name)


def test_the_result_is_the_one_that_fly_wrote(results, simulator):
    with xr.open_datatree(results.flown / "histories.nc", engine="h5netcdf") as tree:
        (flight,) = next(iter(tree.children.values())).children.values()
        written = flight.to_dataset().load()
    now = simulator.fly(0, Choice())
    assert now.inside.all()
    for name in simulator.outputs:
        y = np.asarray(written[f"{name}_fitted"])
        np.testing.assert_allclose(now.simulated[name], y, rtol=1e-6, atol=1e-6 * np.ptp(y), err_msg=name)


def test_other_values_fly_as_the_package_does(results, simulator, card, model):
    agree(simulator.fly(0, Choice({"CLa": 3.9, "Cmde": -1.1})).simulated, packaged(results, card, model, CLa=3.9, Cmde=-1.1))


def test_an_effect_that_is_off_is_the_model_without_it(results, simulator, card, model):
    kept = tuple(e for e in card.effects if e != "separated_moment")
    without = Model.of(kept, card.fixed)
    agree(simulator.fly(0, Choice(off=frozenset({"separated_moment"}))).simulated, packaged(results, card, without))


def test_a_lag_can_be_added_and_switched_off(results, simulator, card, model):
    """Off it is exactly absent, though a lag of zero would leave a fast state."""
    fixed = {name: x for name, x in card.fixed.items() if name != "tau1"}
    lagged = Model.of(card.effects, fixed)
    added = ("separation_lag",)
    agree(simulator.fly(0, Choice({"tau1": 9.0}, added=added)).simulated, packaged(results, card, lagged, tau1=9.0))
    off = simulator.fly(0, Choice({"tau1": 9.0}, frozenset(added), added)).simulated
    agree(off, simulator.fly(0, Choice()).simulated)


def test_a_catalogue_effect_can_be_added(results, simulator, card, model):
    wider = model.extended("mass_scale")
    agree(
        simulator.fly(0, Choice({"mass_scale": 1.04}, added=("mass_scale",))).simulated,
        packaged(results, card, wider, mass_scale=1.04),
    )


def test_effects_are_those_with_parameters_that_act(simulator, model):
    shown = {e.name for e in shown_effects(model)}
    assert "attached_lift" in shown
    assert shown.isdisjoint({"kirchhoff_lift", "separation_lag"})  # without parameters; fixed at neutral by the card
    more = {e.name for e in addable(model, tuple(simulator.flights.channels))}
    assert {"separation_lag", "mass_scale"} <= more
    assert more.isdisjoint({"attached_lift", "vertical_gusts", "longitudinal_gusts"})


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


def test_draws_lie_about_the_estimate(simulator):
    """Standard deviation of the 400 drawn CLa: that of the covariance within four of its own errors (14 %)."""
    origin, fan = simulator.fan(0, count=400, seed=1)
    assert origin.startswith("normal distribution of the estimates")
    assert fan["alpha"].shape == (400, len(simulator.time(0)))
    still = simulator.fly(0, Choice())
    error = simulator.opened.errors["CLa"]
    lower = simulator.fly(0, Choice({"CLa": still.values["CLa"] - error})).coefficients["CL"]
    assert np.isfinite(fan["CL"]).all()
    assert np.std(fan["CL"], axis=0).max() > 0.0
    assert np.ptp(lower) > 0.0


def test_records_that_moved_are_named_with_the_way_to_mend_it(results, tmp_path, monkeypatch):
    import shutil

    monkeypatch.chdir(tmp_path)
    moved, elsewhere = tmp_path / "a" / "b" / "flown", tmp_path / "records"
    shutil.copytree(results.flown, moved)
    with pytest.raises(InputError, match="record stall.csv .* give its folder with --records"):
        open_result(str(moved))
    elsewhere.mkdir()
    shutil.copy(results.folder / "stall.csv", elsewhere)
    assert [r.name for r in open_result(str(moved), None, [elsewhere]).records] == ["stall"]
    (elsewhere / "stall.csv").write_text((elsewhere / "stall.csv").read_text() + "\n")
    with pytest.raises(InputError, match="has changed since"):
        open_result(str(moved), None, [elsewhere])


def test_identify_flies_from_the_measured_state(results, card, model):
    simulator = Simulator(open_result(str(results.identified)))
    assert simulator.opened.departures == {}
    now = simulator.fly(0, Choice()).simulated
    first = {name: simulator.recorded(0)[name][0] for name in ("airspeed", "theta")}
    assert abs(now["airspeed"][0] - first["airspeed"]) < 1.0
    assert abs(now["theta"][0] - first["theta"]) < 0.01
