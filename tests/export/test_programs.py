"""Traced functions as programs, the function of an FMU, and tables, against JAX, the model itself and by hand."""

import ast
from dataclasses import replace
from math import tanh

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from exported_models import everything, modelled, random_signals, six, stall

from bayes_aero.effect import Disturbance
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.export.identified import Draws, Identified, about, translated
from bayes_aero.export.simulators import jsbsim_files, slave_source
from bayes_aero.export.tables import ACCURACY, write_tables
from bayes_aero.flight.card import read_card
from bayes_aero.model.model import Model

FUNCTIONS = {
    "powers": lambda x, y: x**2 + x**3 - x**4 + x**7 + jnp.abs(y) ** x + jnp.cbrt(y) + jax.lax.rsqrt(1.0 + y * y),
    "exponentials": lambda x, y: jnp.exp(x) * jnp.log(2.0 + y) + jnp.expm1(x) - jnp.log1p(y) + jax.nn.sigmoid(9.0 * y),
    "angles": lambda x, y: jnp.sin(x) * jnp.cos(y) + jnp.tan(y) + jnp.arctan2(y, x) + jnp.arcsin(y) - jnp.arccos(y),
    "hyperbolic": lambda x, y: jnp.sinh(x) - jnp.cosh(y) * jnp.tanh(x - y) + jnp.arctan(y),
    "breaks": lambda x, y: jnp.where((x > 0.6) & ~(y < 0.1), x, -y) + jnp.clip(y, -0.2, 0.3) + jnp.sign(y) * x,
    "steps": lambda x, y: jnp.floor(3.0 * x) - jnp.ceil(3.0 * y) + jnp.maximum(x, y) * jnp.minimum(x, 0.5),
    "calls": lambda x, y: jax.jit(lambda z: jnp.square(z) / 3.0)(x) + jax.checkpoint(jnp.sin)(y) + jnp.hypot(x, y),
    "slopes": lambda x, y: jax.jvp(lambda z: jax.nn.sigmoid(z * y) * jnp.sqrt(z), (x,), (jnp.ones_like(x),))[1],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_program_gives_what_the_traced_function_gives(name):
    function = FUNCTIONS[name]
    program = translated(lambda given: {"z": function(given["x"], given["y"])}, {"x": 0.7, "y": 0.2})
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0.1, 1.0, 50), rng.uniform(-0.9, 0.9, 50)
    expected = [float(function(jnp.asarray(a), jnp.asarray(b))) for a, b in zip(x, y, strict=True)]
    np.testing.assert_allclose(program.evaluated({"x": x, "y": y})["z"], expected, rtol=1e-13, atol=1e-14)


def test_programs_by_hand():
    program = translated(lambda given: {"z": jax.nn.sigmoid(2.0 * given["x"]) - 1.0}, {"x": 0.0})
    assert program.evaluated({"x": 0.3})["z"] == pytest.approx((1.0 + tanh(0.3)) / 2.0 - 1.0, abs=1e-16)
    assert program.evaluated({"x": -400.0})["z"] == -1.0


def changed(increments):
    """The stall model with a user's own drag."""
    own = replace(CATALOGUE["separated_drag"], name="my_drag", increments=increments)
    model = stall().model
    effects = tuple(own if e.name == "separated_drag" else e for e in model.effects)
    return replace(stall(), model=replace(model, effects=effects))


@pytest.mark.parametrize(("increments", "words"), [
    (lambda v, *_: {"CD": jnp.sum(jnp.arange(3.0) * v["CDX"])}, "several numbers at once"),
    (lambda v, s, *_: {"CD": v["CDX"] * s["dt"]}, "KeyError: 'dt'"),
    (lambda *given: {"CD": 0.1 if given[3]["X"] > 0.5 else 0.2}, "fails with TracerBoolConversionError"),
    (lambda *given: {"CD": jax.scipy.special.gammaln(given[3]["X"])}, "it uses lgamma"),
])  # fmt: skip
def test_an_effect_that_cannot_be_exported_is_named(increments, words):
    with pytest.raises(InputError, match="effect my_drag cannot be exported") as told:
        _ = changed(increments).program
    assert words in str(told.value)
    assert "\n" not in str(told.value)


def loaded(found):
    """The file's names, from its text alone."""
    names: dict = {}
    exec(compile(slave_source(found, "exported"), "exported.py", "exec"), names)
    return names


def called(names, found, signals, points, k, **more):
    given = {n: float(signals[n][k]) for n in found.program.inputs_of("signal")}
    return names["aerodynamics"](given, {n: float(x[k]) for n, x in points.items()}, **more)


@pytest.mark.parametrize("make", [stall, six, everything, lambda: everything(0.0)])
def test_the_function_is_the_model(make):
    found, n = make(), 20
    names, signals = loaded(found), random_signals(found, n)
    points = {name: np.random.default_rng(2).uniform(0.0, 1.0, n) for name in found.points} if found.lagged else {}
    expected = modelled(found, signals, points or None)
    for k in range(n):
        told = called(names, found, signals, points, k)
        for name, x in expected.items():
            assert told[name] == pytest.approx(x[k], rel=1e-12, abs=1e-12), name


def test_at_rest_the_coefficients_are_finite():
    """Below 1 m/s they are those of 1 m/s; a lag is tau1 chords at it."""
    found = everything()
    names, signals = loaded(found), random_signals(found, 3)
    points = {n: np.full(3, 0.5) for n in found.points}
    there = [called(names, found, signals | {"airspeed": np.full(3, V)}, points, 0) for V in (0.0, 0.4, 1.0)]
    assert there[0] == there[1] == there[2]
    assert np.all(np.isfinite([*there[0].values()]))
    assert there[0]["lag"] == pytest.approx(found.values["tau1"] * found.aircraft.chord)
    assert any("airspeed below 1 m/s" in sentence for sentence in about(found))


def test_a_channel_that_is_no_name_is_refused():
    own = replace(
        CATALOGUE["elevator_drag"],
        channels=("2nd surface",),
        increments=lambda v, s, *_: {"CD": v["CDde"] * s["2nd surface"]},
    )
    found = stall()
    found = replace(found, model=found.model.extended(own), values=found.values | {"CDde": 0.1})
    with pytest.raises(InputError, match="2nd surface cannot be a variable of an FMU"):
        slave_source(found, "mine")
    with pytest.raises(InputError, match="2nd surface cannot be a property of JSBSim"):
        jsbsim_files(found)


def test_words_of_a_card_are_no_code():
    """A title and a source that would end a string."""
    title = 'x"""\nraise SystemExit("run")\n"""\\'
    found = replace(stall(), title=title, sources=(title,))
    tree = ast.parse(slave_source(found, "stall"))
    assert "raise SystemExit" in ast.unparse(tree)
    assert not [n for n in ast.walk(tree) if isinstance(n, ast.Raise) and "SystemExit" in ast.unparse(n)]


def test_errors_of_the_record_and_random_air_are_left_out_and_said():
    card = read_card("attas")
    model = Model.from_card(card).extended("pitch_rate_bias", "thrust_scale", "vertical_gust", "buffet", "cg_shift")
    values = stall().values | {p.name: 0.01 for p in model.parameters if p.name not in stall().values}
    found = Identified("gusty", "t", model, card.aircraft, values, ())
    named = {sentence.split(" ")[0] for sentence in found.left_out}
    assert named == {"pitch_rate_bias", "thrust_scale", "vertical_gust", "buffet"}
    assert isinstance(CATALOGUE["buffet"].disturbance, Disturbance)
    assert set(found.left_out) <= set(about(found))
    assert found.actual_aircraft.reference_point[0] == pytest.approx(-0.02 - 0.01)  # the shift moves all else aft


# Tables, interpolated by xarray: their sums are the coefficients, within the accuracy that they state
FLOWN = {
    "alpha": (0.0, 0.32), "alpha_dot": (-0.1, 0.08), "airspeed": (60.0, 110.0), "mach": (0.2, 0.35), "q": (-0.1, 0.1),
    "elevator": (-0.2, 0.1), "beta": (-0.1, 0.1), "p": (-0.2, 0.2), "r": (-0.1, 0.1), "aileron": (-0.1, 0.1),
    "rudder": (-0.1, 0.1),
}  # fmt: skip
N = 200


def written(found, folder):
    files = write_tables(found, folder)
    with xr.open_datatree(folder / "tables.nc", engine="h5netcdf") as tree:
        return files, {name: node.to_dataset().load() for name, node in tree.children.items()}, tree.attrs


def summed(tables, output, signals, variable="value"):
    """The sum of an output's tables at samples, and of their stated errors."""
    total, error = 0.0, 0.0
    for table in tables.values():
        if table["value"].attrs["output"] == output:
            points = {d: xr.DataArray(signals[d], dims="n") for d in table["value"].dims}
            part = table[variable]
            total = total + (part.interp(points) if points else part).values
            error += table["value"].attrs["interpolation_error"]
    return total, error


@pytest.mark.parametrize(("make", "tau1"), [(stall, 0.0), (six, 4.0)])
def test_tables_of_few_axes_in_their_order_are_the_model(make, tau1, tmp_path):
    """Incidence, static separation point, coefficients: as the README of an export says."""
    found = replace(make(), flown=FLOWN)
    files, tables, about = written(found, tmp_path)
    assert set(files) == {"tables.nc", *(f"{name}.csv" for name in tables)}
    assert max(len(table["value"].dims) for table in tables.values()) <= 3
    assert "sum of its tables" in about["sum"]
    rng = np.random.default_rng(7)
    signals = random_signals(found, N) | {n: rng.uniform(*FLOWN[n], N) for n in found.signals}
    incidence, _ = summed(tables, "incidence", signals)
    X, _ = summed(tables, "X_static", {"incidence": incidence})
    static = (1.0 - np.tanh(25.0 * (signals["alpha"] - 20.0 * 3.159 / signals["airspeed"] *
                                    np.minimum(signals["alpha_dot"], 0.0) - 0.27))) / 2.0  # fmt: skip
    np.testing.assert_allclose(X, static, atol=5e-3)
    for name, expected in modelled(found, signals, {"X": static}).items():
        total, error = summed(tables, name, signals | {"X": static})
        assert error <= 4.0 * ACCURACY * np.ptp(expected)
        np.testing.assert_allclose(total, expected, atol=2.0 * error + 1e-9, err_msg=name)
    if tau1:
        total, error = summed(tables, "lag", signals)
        np.testing.assert_allclose(total, tau1 * 3.159 / signals["airspeed"], atol=2.0 * error)


def test_files_state_units_and_bounds_and_draws_have_tables_of_their_own(tmp_path):
    draws = Draws(("Cmq",), np.array([[-4.0], [-16.0]]), "a test")
    _, tables, about = written(stall(flown=FLOWN, draws=draws), tmp_path)
    table = tables["Cm_airspeed_q"]
    assert (table["airspeed"].attrs["units"], table["q"].attrs["units"]) == ("m/s", "rad/s")
    assert (float(table["airspeed"][0]), float(table["airspeed"][-1])) == FLOWN["airspeed"]
    assert "alpha 0 to 0.32 rad" in about["about"]
    frame = pd.read_csv(tmp_path / "Cm_airspeed_q.csv")
    assert list(frame)[:3] == ["airspeed [m/s]", "q [rad/s]", "Cm [1]"]
    np.testing.assert_allclose(frame["Cm [1]"], table["value"].values.ravel(), rtol=1e-11)
    by_hand = -8.0 * frame["q [rad/s]"] * 3.159 / frame["airspeed [m/s]"]
    np.testing.assert_allclose(frame["Cm [1]"], by_hand, rtol=1e-9)
    for k, factor in enumerate((0.5, 2.0)):
        np.testing.assert_allclose(table["draws"].sel(draw=k), factor * table["value"], rtol=1e-12)
    with pytest.raises(InputError, match="flown range of airspeed is not known"):
        write_tables(stall(), tmp_path)
