"""FlightRecord: immutable, named, in SI; and its resampling."""

import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from flight_samples import CHANNELS, sound

from bayes_aero.errors import InputError
from bayes_aero.flight.reading.checks import check_record
from bayes_aero.flight.reading.read_record import read_record, write_record
from bayes_aero.flight.reading.resample import resample_record
from bayes_aero.flight.record import FlightRecord


def test_what_it_holds():
    record = sound()
    assert len(record) == record.n == 120
    assert record.dt == pytest.approx(0.04, rel=1e-12)
    assert record.names[0] == "time"
    assert record.has("alpha")
    assert not record.has("beta")
    assert record["time"] is record.time
    assert len(record.sha256) == 64


def test_it_is_immutable():
    values = np.arange(60.0)
    record = FlightRecord.from_arrays("r", np.arange(60.0), {"alpha": values})
    values[0] = 7.0
    assert record["alpha"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record["alpha"][0] = 1.0
    with pytest.raises(TypeError):
        record.channels["beta"] = values  # pyright: ignore[reportIndexIssue]
    with pytest.raises(FrozenInstanceError):
        record.name = "other"  # pyright: ignore[reportAttributeAccessIssue]


def test_hash_is_of_the_content():
    record, same, other = sound(), sound(), sound(q=np.zeros(120))
    assert record.sha256 == same.sha256 != other.sha256


def test_missing_channel_is_named():
    with pytest.raises(InputError, match=r"record sound has no channel alhpa \(did you mean alpha\?\).*time, alpha, q"):
        sound()["alhpa"]


def test_odd_arrays():
    for channels, words in (
        ({"q": np.zeros(5)}, "channel q has 5 samples where time has 3"),
        ({"q": np.zeros((3, 2))}, "shape"),
        ({"q": np.array(["a", "b", "c"])}, "not numeric"),
    ):
        with pytest.raises(InputError, match=words):
            FlightRecord.from_arrays("r", np.arange(3.0), channels)
    with pytest.raises(InputError, match="two are needed"):
        _ = FlightRecord.from_arrays("r", np.zeros(1), {}).dt


def test_pickle_for_worker_processes():
    record = sound()
    again = pickle.loads(pickle.dumps(record))
    assert again.sha256 == record.sha256
    np.testing.assert_array_equal(again["alpha"], record["alpha"])


def test_window():
    record = sound()
    part = record.window(1.0, 3.0)
    assert part.n == 51
    np.testing.assert_allclose(part.time[[0, -1]], [1.0, 3.0])
    np.testing.assert_array_equal(part["q"], record["q"][25:76])
    assert part.sha256 == record.sha256
    assert part.name != record.name
    with pytest.raises(InputError, match="no sample between 9 and 10 s"):
        record.window(9, 10)


def uneven(n: int = 400) -> FlightRecord:
    rng = np.random.default_rng(0)
    t = np.cumsum(0.04 * (1 + 0.2 * rng.uniform(-1, 1, n)))
    channels = {"alpha": 0.1 + 0.05 * np.sin(2 * t), "psi": np.mod(0.5 * t, 2 * np.pi), "gear": (t > 5) * 1.0}
    return FlightRecord.from_arrays("uneven", t, channels)


@pytest.mark.parametrize("dt", [0.02, 0.04, 0.1, 0.13])
def test_resampling(dt):
    record = uneven()
    even = resample_record(record, dt)
    np.testing.assert_allclose(np.diff(even.time), dt, rtol=1e-9)
    assert record.time[-1] - dt < even.time[-1] <= record.time[-1] + 1e-9
    inner = slice(3, -3)
    np.testing.assert_allclose(even["alpha"][inner], 0.1 + 0.05 * np.sin(2 * even.time[inner]), atol=2e-4)
    np.testing.assert_allclose(even["psi"][inner], 0.5 * even.time[inner], atol=2e-3)  # through the jump at 360 degrees
    assert set(even["gear"]) <= {0.0, 1.0}
    assert f"resampled to {dt:g} s" in even.source
    assert even.sha256 == record.sha256


def test_thinning_out_does_not_fold_noise_into_the_record():
    t = np.arange(4000) * 0.01
    fast = FlightRecord.from_arrays("f", t, {"alpha": 0.1 * np.sin(t) + 0.05 * np.sin(2 * np.pi * 23.0 * t)})
    slow = resample_record(fast, 0.04)  # 23 Hz would come back as 2 Hz
    np.testing.assert_allclose(slow["alpha"][20:-20], 0.1 * np.sin(slow.time[20:-20]), atol=1e-3)


def test_an_even_record_is_unchanged_by_resampling_to_its_own_interval():
    record = sound()
    again = resample_record(record, 0.04)
    np.testing.assert_allclose(again["alpha"], record["alpha"], atol=1e-12)
    assert again.n == record.n


def test_what_resampling_refuses():
    record = sound(time=np.arange(120) * 0.04 + (np.arange(120) > 70) * 0.5)
    with pytest.raises(InputError, match=r"gap of 0.54 s after t = 2.8 s.*5 median steps.*cut the record"):
        resample_record(record, 0.04)
    for dt in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="positive number"):
            resample_record(sound(), dt)
    with pytest.raises(InputError, match="longer interval"):
        resample_record(sound(), 1e-9)


def test_resampling_only_when_asked(tmp_path):
    time = np.arange(120) * 0.04
    time[50] += 0.01
    path = tmp_path / "uneven.csv"
    write_record(sound(time=time), path, CHANNELS)
    with pytest.raises(InputError, match=r"uneven.csv: .*unevenly.*sample 49 .*--resample 0.04"):
        read_record(path, CHANNELS)
    record = read_record(path, CHANNELS, resample=0.04)
    check_record(record)
    with pytest.raises(InputError, match=r"uneven.csv: .*10 samples.*50"):
        read_record(path, CHANNELS, resample=0.5)
