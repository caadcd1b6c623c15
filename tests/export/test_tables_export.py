"""Tables of a model, interpolated by xarray: their sums are the coefficients, within the accuracy that they state."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from exported_models import modelled, random_signals, six, stall

from bayes_aero.errors import InputError
from bayes_aero.export.identified import Draws
from bayes_aero.export.tables import ACCURACY, write_tables

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


def samples(found):
    rng = np.random.default_rng(7)
    signals = {n: rng.uniform(*FLOWN[n], N) for n in found.signals}
    return random_signals(found, N) | signals


@pytest.mark.parametrize("make", [stall, lambda **more: stall(5.0, **more)])
def test_tables_in_their_order_are_the_model(make, tmp_path):
    """Incidence, static separation point, coefficients: as the README of an export says."""
    found = make(flown=FLOWN)
    _, tables, _ = written(found, tmp_path)
    signals = samples(found)
    incidence, _ = summed(tables, "incidence", signals)
    X, _ = summed(tables, "X_static", {"incidence": incidence})
    static = (1.0 - np.tanh(25.0 * (signals["alpha"] - 20.0 * 3.159 / signals["airspeed"] *
                                    np.minimum(signals["alpha_dot"], 0.0) - 0.27))) / 2.0  # fmt: skip
    np.testing.assert_allclose(X, static, atol=5e-3)
    for name, expected in modelled(found, signals, {"X": static}).items():
        told, error = summed(tables, name, signals | {"X": static})
        assert error <= 4.0 * ACCURACY * np.ptp(expected)
        np.testing.assert_allclose(told, expected, atol=2.0 * error + 1e-9, err_msg=name)
    if found.lagged:
        told, error = summed(tables, "lag", signals)
        np.testing.assert_allclose(told, 5.0 * 3.159 / signals["airspeed"], atol=2.0 * error)


def test_six_coefficients_have_tables_of_few_axes(tmp_path):
    found = six()
    object.__setattr__(found, "flown", FLOWN)
    files, tables, about = written(found, tmp_path)
    assert max(len(table["value"].dims) for table in tables.values()) <= 3
    assert "sum of its tables" in about["sum"]
    signals = samples(found) | {"X": np.random.default_rng(1).uniform(0.0, 1.0, N)}
    for name, expected in modelled(found, signals, {"X": signals["X"]}).items():
        told, error = summed(tables, name, signals)
        np.testing.assert_allclose(told, expected, atol=2.0 * error + 1e-9, err_msg=name)
    assert set(files) == {"tables.nc", *(f"{name}.csv" for name in tables)}


def test_files_state_units_bounds_and_the_same_numbers(tmp_path):
    found = stall(flown=FLOWN)
    _, tables, about = written(found, tmp_path)
    table = tables["Cm_airspeed_q"]
    assert table["airspeed"].attrs["units"] == "m/s"
    assert table["q"].attrs["units"] == "rad/s"
    assert (float(table["airspeed"][0]), float(table["airspeed"][-1])) == FLOWN["airspeed"]
    assert "alpha 0 to 0.32 rad" in about["about"]
    frame = pd.read_csv(tmp_path / "Cm_airspeed_q.csv")
    assert list(frame) == ["airspeed [m/s]", "q [rad/s]", "Cm [1]"]
    np.testing.assert_allclose(frame["Cm [1]"], table["value"].values.ravel(), rtol=1e-11)
    by_hand = -8.0 * frame["q [rad/s]"] * 3.159 / frame["airspeed [m/s]"]
    np.testing.assert_allclose(frame["Cm [1]"], by_hand, rtol=1e-9)


def test_draws_have_tables_of_their_own_and_unknown_ranges_none(tmp_path):
    drawn = Draws(("Cmq",), np.array([[-4.0], [-16.0]]), "a test")
    _, tables, _ = written(stall(flown=FLOWN, draws=drawn), tmp_path)
    table = tables["Cm_airspeed_q"]
    np.testing.assert_allclose(table["draws"].sel(draw=0), 0.5 * table["value"], rtol=1e-12)
    np.testing.assert_allclose(table["draws"].sel(draw=1), 2.0 * table["value"], rtol=1e-12)
    with pytest.raises(InputError, match="flown range of airspeed is not known"):
        write_tables(stall(), tmp_path)
