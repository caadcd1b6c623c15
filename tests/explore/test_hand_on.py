"""What is shown is what is exported: any combination of effects, in every form."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest

from bayes_aero.errors import InputError
from bayes_aero.explore.choice import Choice, flown_model
from bayes_aero.explore.hand_on import chosen_model, export_chosen
from bayes_aero.explore.opened import open_result
from bayes_aero.explore.simulator import Simulator
from bayes_aero.explore.sliders import groups_of
from bayes_aero.export.python_source import python_source
from bayes_aero.jobs.handover.export import FORMS

CHOICES = {
    "moved": Choice({"CLa": 3.9}),
    "attached": Choice(off=frozenset({"flow_separation", "reattachment_hysteresis"})),
    "lagged": Choice({"tau1": 9.0}, added=("separation_lag",)),
    "lag off": Choice({"tau1": 9.0}, frozenset({"separation_lag"}), ("separation_lag",)),
    "sensor": Choice({"alpha_bias": 0.01}, frozenset({"mach_lift"}), ("alpha_bias", "alpha_dot_moment")),
}


@pytest.fixture(scope="module")
def own(results, tmp_path_factory):
    """A simulator of a result that may be written to."""
    folder = tmp_path_factory.mktemp("handed") / "flown"
    shutil.copytree(results.flown, folder)
    return Simulator(open_result(str(folder), None, [results.folder]))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", CHOICES)
def test_every_form_takes_every_choice(own, form, name):
    values = own.fly(0, CHOICES[name]).values
    folder, files = export_chosen(own.opened, CHOICES[name], values, form)
    assert folder.parent == own.opened.folder / "exports"
    assert all((folder / file).stat().st_size > 0 for file in files)


@pytest.mark.parametrize("name", ["moved", "attached", "sensor"])
def test_the_exported_function_has_the_coefficients_of_the_page(own, name):
    """The function of an FMU at single samples of the corrected record, against the model that is flown."""
    choice = CHOICES[name]
    values = own.fly(0, choice).values
    chosen, exported = chosen_model(own.opened, choice, values), {}
    exec(compile(python_source(chosen), "exported.py", "exec"), exported)
    flown, flights = flown_model(own.opened.identified.model, choice), own.flights
    arrays = {name: np.asarray(x) for name, x in values.items()}
    channels = flights.with_slopes(flown.corrected(arrays, flights.channels, flights.aircraft))
    for k in (100, 300, 500):
        signals = {name: np.asarray(x)[k] for name, x in channels.items()}
        expected = flown.flow(arrays, signals, flights.aircraft)
        told = exported["aerodynamics"](**{name: float(signals[name]) for name in chosen.signals})
        for c in ("CL", "CD", "Cm"):
            assert told[c] == pytest.approx(float(expected[c]), rel=1e-9, abs=1e-12), (c, k)


def test_a_folder_that_cannot_be_made_is_one_sentence(own):
    blocked = own.opened.folder / "exports"
    shutil.rmtree(blocked, ignore_errors=True)
    blocked.write_text("a file")
    with pytest.raises(InputError, match=r"cannot write .*exports"):
        export_chosen(own.opened, Choice(), own.fly(0, Choice()).values, "jsbsim")
    blocked.unlink()


def test_sliders_hold_the_estimate_within_the_bounds(own):
    identified = own.opened.identified
    groups = groups_of(identified.model, identified.values, own.opened.errors, ("separation_lag", "mass_scale"))
    sliders = {s.name: s for group in groups for s in group.sliders}
    bounds = {p.name: p.bounds for p in identified.model.extended("mass_scale").parameters}
    for s in sliders.values():
        assert math.isfinite(s.low)
        assert math.isfinite(s.high)
        assert s.low <= s.value <= s.high
        assert s.low < s.high
        assert s.low / s.factor >= bounds[s.name][0] - 1e-12
        assert s.high / s.factor <= bounds[s.name][1] + 1e-12
    star = sliders["alpha_star"]
    assert star.unit == "deg"
    assert star.value == pytest.approx(math.degrees(identified.values["alpha_star"]))
    reach = max(5.0 * math.degrees(own.opened.errors["alpha_star"]), 0.3 * star.value)
    assert star.high == pytest.approx(star.value + reach)
    assert [group.added for group in groups if group.name in ("separation_lag", "mass_scale")] == [True, True]
