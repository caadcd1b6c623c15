"""`bayes-aero path`: errors of sensors hidden in an invented flight of smooth attitudes and velocities."""

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock, patch

import numpy as np
import pandas as pd
import pytest
from calling import answer, called, holds, page_of, refused, succeeded
from scipy.signal import lfilter

from bayes_aero.diagnosis.result import TrajectoryFit
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs import fly as job
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.results import Flight
from bayes_aero.report.pages.fly import fly_sentences

AIRCRAFT = {
    "mass": "6000 kg", "Ix": "1e4 kg m^2", "Iy": "3e4 kg m^2", "Iz": "4e4 kg m^2", "Ixz": "0 kg m^2",
    "wing_area": "30 m^2", "chord": "2.4 m", "half_span": "7.2 m", "aspect_ratio": 7.0, "tail_arm": "8 m",
    "reference_point": ["0 m", "0 m", "0 m"], "accelerometer": ["1.5 m", "0.3 m", "-0.2 m"],
    "engine": ["0 m", "0 m", "0 m"], "engine_inclination": "0 deg",
}  # fmt: skip
# Output error knows no noise of what it integrates, so accelerometers and gyros have little.
NOISE = {
    "ax": 0.001, "ay": 0.001, "az": 0.002, "p": 2e-5, "q": 2e-5, "r": 2e-5, "phi": 1e-3, "theta": 1e-3, "psi": 1e-3,
    "alpha": 1e-3, "beta": 1e-3, "airspeed": 0.1, "altitude": 0.5,
}  # fmt: skip
UNITS = dict.fromkeys(("ax", "ay", "az"), "m/s^2") | dict.fromkeys("pqr", "rad/s")
UNITS |= dict.fromkeys(("phi", "theta", "psi", "alpha", "beta"), "rad") | {"airspeed": "m/s", "altitude": "m"}
HIDDEN = {"accel_z_bias": 0.08, "pitch_rate_bias": 0.002, "roll_rate_bias": -0.001, "alpha_delay": 0.06}
SCALE, VANE, PLACE, G, DT = 0.05, 6.0, (1.5, 0.3, -0.2), 9.80665, 0.02


def true_flight(t):
    """Body velocities, attitude, rates and specific force at the centre of gravity, and what is derived from them."""
    # Ten times finer than the record, so that central differences are as good as derivatives.
    fine = np.arange(0.0, t[-1] + DT, DT / 10)
    phi, psi = 0.4 * np.sin(0.5 * fine), 1.0 + 0.3 * np.sin(0.17 * fine)
    theta = 0.06 + 0.08 * np.sin(0.9 * fine) + 0.03 * np.sin(2.3 * fine)
    alpha, beta = 0.08 + 0.05 * np.sin(0.8 * fine + 0.4) + 0.02 * np.sin(2.1 * fine), 0.04 * np.sin(0.7 * fine + 1.0)
    V = 90.0 + 5.0 * np.sin(0.2 * fine)
    d = lambda x: np.gradient(x, fine, edge_order=2)
    p = d(phi) - d(psi) * np.sin(theta)
    q = d(theta) * np.cos(phi) + d(psi) * np.cos(theta) * np.sin(phi)
    r = -d(theta) * np.sin(phi) + d(psi) * np.cos(theta) * np.cos(phi)
    v = V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    omega = np.array([p, q, r])
    down = np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    turn = lambda a, b: np.cross(a, b, axis=0)
    force = np.array([d(x) for x in v]) + turn(omega, v) - G * down
    spin = np.array([d(x) for x in omega])
    place = np.array(PLACE)[:, None] * np.ones_like(fine)
    at_sensor = force + turn(spin, place) + turn(omega, turn(omega, place))
    climb = -(v * down).sum(0)
    height = np.concatenate([[0.0], np.cumsum(np.diff(fine) * 0.5 * (climb[1:] + climb[:-1]))])
    true = dict(zip(("ax", "ay", "az"), at_sensor, strict=True)) | {"p": p, "q": q, "r": r, "altitude": 3000.0 + height}
    true |= {"phi": phi, "theta": theta, "psi": psi, "alpha": alpha, "beta": beta, "airspeed": V}
    return {name: np.interp(t, fine, x) for name, x in true.items()} | {"late": (fine, alpha)}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Card and record with errors of sensors, and the truth."""
    folder, rng = tmp_path_factory.mktemp("path"), np.random.default_rng(8)
    t = DT * np.arange(1800)
    truth = true_flight(t)
    fine, alpha = truth.pop("late")
    recorded = dict(truth)
    q, V = (np.interp(fine, t, truth[name]) for name in ("q", "airspeed"))
    at_vane = np.arctan2(np.sin(alpha) - VANE * q / V, np.cos(alpha))
    recorded["alpha"] = (1.0 + SCALE) * np.interp(t - HIDDEN["alpha_delay"], fine, at_vane)
    recorded["beta"] = np.arctan(np.tan(truth["beta"]) + VANE * truth["r"] / truth["airspeed"])
    recorded["az"] = recorded["az"] + HIDDEN["accel_z_bias"]
    recorded["q"] = recorded["q"] + HIDDEN["pitch_rate_bias"]
    recorded["p"] = recorded["p"] + HIDDEN["roll_rate_bias"]
    noisy = {name: recorded[name] + rng.normal(0.0, NOISE[name], len(t)) for name in UNITS}
    record, card = folder / "invented.csv", folder / "card.toml"
    pd.DataFrame({"time": t} | noisy).to_csv(record, index=False)
    lines = [f'{n} = {{ label = "{n}", unit = "{u}" }}' for n, u in ({"time": "s"} | UNITS).items()]
    lines = ["[aircraft]", *(f"{n} = {json.dumps(x)}" for n, x in AIRCRAFT.items()), "[channels]", *lines]
    effects = ["attached_lift", "pitching_moment", "profile_drag"]
    card.write_text("\n".join([*lines, "[model]", f"effects = {effects}"]))
    return card, record, truth


@pytest.fixture(scope="module")
def reconstructed(flight, tmp_path_factory):
    """A folder with the result of `path` on this flight, and the fit itself."""
    card, record, _ = flight
    folder, fits = tmp_path_factory.mktemp("reconstructed"), []
    with patch.object(job, "fly", side_effect=lambda *given, **more: fits.append(fly(*given, **more)) or fits[-1]):
        succeeded(called(folder, "path", record, "--model", card, "--out", "out", "--no-figures"))
    return folder / "out", fits[0]


def test_errors_of_sensors_are_found_and_taken_out(reconstructed, flight):
    out, truth = reconstructed[0], flight[2]
    content = json.loads((out / "trajectories.json").read_text())
    assert content["status"] == "converged"
    expected = HIDDEN | {"alpha_scale": SCALE, "vane_position": VANE}
    for name, p in content["parameters"].items():
        assert abs(p["estimate"] - expected.get(name, 0.0)) < 3.5 * p["sd_corrected"], name
    for name, size in expected.items():
        assert content["parameters"][name]["sd_corrected"] < 0.15 * abs(size), name
    for name, sd in content["residual_sd"].items():
        assert sd == pytest.approx(NOISE[name], rel=0.25), name
    corrected = pd.read_csv(out / "corrected" / "invented.csv")
    for name in ("alpha", "beta", "az", "q", "p"):
        away = (corrected[name].to_numpy() - truth[name])[10:-10]
        assert abs(np.mean(away)) < 4.0 * NOISE[name] / np.sqrt(len(away)) + 0.3 * NOISE[name], name
        assert np.std(away) < 1.5 * NOISE[name], name
    assert "Recorded accelerations and rates drive the simulation" in page_of(out)


@pytest.mark.verify
def test_an_airspeed_with_a_pitot_offset_is_made_true(program, flight, tmp_path):
    """300 Pa is 3.2 m/s at 90 m/s and 1.05 kg/m^3; three errors of the airspeed share it, and their sum is right."""
    card, record, truth = flight
    table, density = pd.read_csv(record), 1.05
    table["airspeed"] = np.sqrt(table["airspeed"] ** 2 + 2.0 * 300.0 / density)
    table.to_csv(tmp_path / "leak.csv", index=False)
    (tmp_path / "leak.toml").write_text(card.read_text() + f'\n[constants]\ndensity = "{density} kg/m^3"\n')
    content = answer(program("path", "leak.csv", "--model", "leak.toml", "--out", "out", "--no-figures", "--json"))
    for name, true in {"pitot_pressure_bias": 300.0, "airspeed_bias": 0.0, "airspeed_scale": 0.0}.items():
        parameter = content["parameters"][name]
        assert abs(parameter["estimate"] - true) < 3.5 * parameter["sd_corrected"], name
    corrected = pd.read_csv(tmp_path / "out" / "corrected" / "leak.csv")["airspeed"].to_numpy()
    assert np.mean(table["airspeed"].to_numpy() - truth["airspeed"]) > 3.0
    assert abs(np.mean(corrected - truth["airspeed"])) < 0.3


def test_a_fit_that_is_worse_than_the_record_is_not_used(program, flight, reconstructed, monkeypatch):
    card, record, _ = flight
    errors = {"airspeed": (0.84, 1.6), "alpha": (0.1, 0.1)}
    monkeypatch.setattr(TrajectoryFit, "rms_errors", property(lambda _: errors))
    worse = replace(reconstructed[1], sentences=tuple(fly_sentences(reconstructed[1].flown, "")))
    monkeypatch.setattr(job, "fly", lambda *_, **__: worse)
    done = succeeded(program("path", record, "--model", card, "--out", "out"), 3)
    holds(done.out, "The fit is worse than the record as it is.", "V 0.84 → 1.6 m/s")
    assert "bayes-aero qualify" not in done.out
    assert not Path("out/corrected").exists()


def test_a_record_of_symmetric_flight_has_no_errors_of_lateral_sensors(flight, tmp_path):
    less(flight, tmp_path, "ay", "p", "r", "phi", "psi", "beta")
    card = read_card(tmp_path / "less.toml")
    _, dynamics, _ = job.flown_dynamics(read_records([tmp_path / "less.csv"], card.channels), card, (), path=True)
    assert set(dynamics.outputs) == {"airspeed", "alpha", "theta", "altitude"}
    lateral = {"sideslip_scale", "bank_angle_bias", "roll_rate_bias", "accel_y_bias"}
    assert lateral.isdisjoint(p.name for p in dynamics.free)


def test_what_a_flight_path_lacks_is_one_sentence(program, flight, tmp_path):
    for channel, words in {"az": "no channel az", "phi": "needs phi, because the aircraft rolled"}.items():
        less(flight, tmp_path, channel)
        refused(program("path", "less.csv", "--model", "less.toml"), words, gone=["path/trajectories.json"])


def less(flight, folder, *channels):
    """The first 12 s of the record without these channels, and the card."""
    card, record, _ = flight
    pd.read_csv(record, nrows=600).drop(columns=list(channels)).to_csv(folder / "less.csv", index=False)
    lines = [line for line in card.read_text().splitlines() if line.split(" ")[0] not in channels]
    (folder / "less.toml").write_text("\n".join(lines))


@pytest.fixture
def corrected(monkeypatch):
    """`flight_path` of records that need no correction: what is left of it writes files."""
    fit = Mock(spec=Flight, flown=Mock(spec=TrajectoryFit, converged=True, worse=False))
    monkeypatch.setattr(job, "the_fit", fit, raising=False)
    monkeypatch.setattr(job, "fly", lambda *_, **__: fit)
    monkeypatch.setattr(job, "corrected_records", lambda records, _: list(records))

    def run(out, *names):
        record = FlightRecord.from_arrays("flight", 0.02 * np.arange(60), {"q": np.zeros(60)})
        card = replace(read_card("attas"), channels=(Channel("time", "s"), Channel("q", "rad/s")))
        out.mkdir(exist_ok=True)
        job.flight_path([replace(record, name=name) for name in names], card, out=out)
        return sorted(p.name for p in (out / "corrected").iterdir())

    return run


def test_files_that_path_did_not_write_stay_and_each_record_has_one(tmp_path, corrected):
    folder = tmp_path / "out" / "corrected"
    assert corrected(tmp_path / "out", "one", "two") == ["one.csv", "two.csv", "written.json"]
    (folder / "mine.csv").write_text("of the user\n")
    (folder / "two.csv").write_text("changed by the user\n")
    assert corrected(tmp_path / "out", "three") == ["mine.csv", "three.csv", "two.csv", "written.json"]
    assert (folder / "mine.csv").read_text() == "of the user\n"
    for name in ("mine", "two"):
        with pytest.raises(InputError, match=rf"{name}\.csv is not as bayes-aero path wrote it, and would be replaced"):
            corrected(tmp_path / "out", name)
    assert (folder / "three.csv").is_file()
    (folder / "written.json").write_text('{"files": {"../mine.csv": 3}}')
    (tmp_path / "out" / "mine.csv").write_text("elsewhere")
    assert corrected(tmp_path / "out", "four") == ["four.csv", "mine.csv", "three.csv", "two.csv", "written.json"]
    assert (tmp_path / "out" / "mine.csv").is_file()
    assert corrected(tmp_path / "new", "run/1", "run_1") == ["run_1.csv", "run_1_2.csv", "written.json"]
    job.the_fit.flown.worse = True
    assert corrected(tmp_path / "new", "run/1") == ["written.json"]  # none of an earlier fit


def first_order(rng, t, sd, seconds):
    """A stationary random process with this correlation time."""
    kept = np.exp(-(t[1] - t[0]) / seconds)
    white = np.concatenate([rng.normal(0.0, sd, 1), sd * np.sqrt(1.0 - kept**2) * rng.normal(size=len(t) - 1)])
    return lfilter([1.0], [1.0, -kept], white)


@pytest.mark.verify
def test_gusts_are_met_by_vane_and_pitot_tube_alone(program, flight, tmp_path):
    """Intensities, lengths and errors of sensors, without aerodynamics; noise of accelerometers is counted."""
    card, _, _ = flight
    t, rng = DT * np.arange(1800), np.random.default_rng(1)
    truth = true_flight(t)
    truth.pop("late")
    w, u = first_order(rng, t, 0.5, 200.0 / 90.0), first_order(rng, t, 0.3, 200.0 / 90.0)
    truth["alpha"] = 1.04 * (truth["alpha"] + w / truth["airspeed"])
    truth["airspeed"] = truth["airspeed"] + u
    noise = {n: sd * (10.0 if n in ("ax", "ay", "az", "p", "q", "r") else 1.0) for n, sd in NOISE.items()}
    noisy = {n: x + rng.normal(0.0, noise[n], len(t)) for n, x in truth.items()}
    pd.DataFrame({"time": t} | noisy).to_csv(tmp_path / "gusty.csv", index=False)
    done = program("path", "gusty.csv", "--model", card, "--process-noise", "--out", "out", "--json")
    filtered = answer(done, 0, 3)["process_noise"]
    assert filtered["status"] == "converged"
    for name, size in {"vertical_gust": 0.5, "longitudinal_gust": 0.3}.items():
        (estimate, sd), (length, of_length) = (filtered["gusts"][n] for n in (name, f"{name}_length"))
        assert abs(estimate - size) < 3.0 * sd < 0.9 * size, name
        assert abs(length - 200.0) < 3.0 * of_length, name
        assert of_length > 0.2 * length  # a record of 16 lengths says no more of one
    assert max(map(abs, filtered["autocorrelation"].values())) < 0.08
    expected = {"alpha_scale": 0.04}
    for name in ("vane_position", "alpha_scale", "alpha_delay", "sideslip_scale", "airspeed_scale", "accel_z_bias"):
        estimate, sd = filtered["estimates"][name]
        assert abs(estimate - expected.get(name, 0.0)) < 3.0 * sd, name
    gusts = pd.read_csv(tmp_path / "out" / "gusts.csv")
    assert np.std(gusts["gust_u"].to_numpy() - u) < 0.6 * np.std(u)
    assert (tmp_path / "out" / "figures" / "gusts.png").exists()
