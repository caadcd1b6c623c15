"""Whatever bytes a file holds, reading it ends soon, in a record or in an InputError."""

import io
import warnings
from contextlib import suppress
from pathlib import Path

import fuzzing
import numpy as np
import pytest
import xarray as xr
from flight_samples import CHANNELS, sound, written
from hypothesis import given
from hypothesis import strategies as st

from bayes_aero.errors import InputError
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import WRITERS
from bayes_aero.units import to_si

# .nc starts a process for each file, so it gets fewer examples; its time limit stands in for the deadline.
EXAMPLES = {".asc": 100, ".csv": 100, ".mat": 100, ".parquet": 100, ".nc": 12, "classic.nc": 60}
MAGIC = {
    ".mat": b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM", ".parquet": b"PAR1", ".nc": b"\x89HDF\r\n\x1a\n",
    "classic.nc": b"CDF\1",
}  # fmt: skip
IN_SI = {c.name: float(to_si(1.0, c.unit, c.name)) for c in CHANNELS}


@pytest.fixture(autouse=True)
def short_time_limit(monkeypatch):
    monkeypatch.setattr("bayes_aero.flight.binary.TIME_LIMIT", 2.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def valid(folder) -> dict[str, bytes]:
    contents = {}
    for suffix in EXAMPLES:
        path = folder / f"valid{suffix}"
        if suffix == "classic.nc":
            record = sound(60)
            variables = {c.heading: ("t", record[c.name], {"units": "1"}) for c in CHANNELS}
            xr.Dataset(variables).to_netcdf(path, engine="scipy")
        else:
            written(path, sound(60))
        contents[suffix] = path.read_bytes()
    return contents


def read(folder: Path, suffix: str, content: bytes) -> None:
    """It ends in a record of numbers, or is refused properly."""
    path, message = folder / f"fuzz{suffix}", ""
    path.write_bytes(content)
    with warnings.catch_warnings(record=True) as leaked:
        warnings.simplefilter("always")
        try:
            record = read_record(path, CHANNELS)
            assert all(np.isfinite(record[name]).all() for name in record.names)
        except InputError as error:
            message = str(error)
    assert not leaked, leaked
    assert not message or message.startswith(f"{path}: ")
    assert "\n" not in message
    assert len(message) < 1500


def examples(suffix: str, share: float = 1.0):
    return fuzzing.examples(share * EXAMPLES[suffix], None if suffix == ".nc" else 2.0)


def random(suffix, _):
    return st.tuples(st.sampled_from([b"", MAGIC.get(suffix, b"")]), st.binary(max_size=400)).map(b"".join)


def words(*_):
    text = st.text(alphabet='0123456789.,;:eE+-_ \t\n\r"#%TALCGVnaif', max_size=300) | st.text(max_size=100)
    cells = text.map(lambda content: content.encode("utf-8", "surrogatepass"))
    return st.tuples(st.sampled_from([b"", b"T,ALCG,QRGY,VTAS,RHO\n"]), cells).map(b"".join)


def mutated(_, valid):
    """Headers and footers decide how a file is understood, so half of the changes go there."""
    size = len(valid)
    places = st.integers(0, size - 1) | st.integers(0, min(600, size - 1)) | st.integers(max(0, size - 600), size - 1)

    def changed(changes):
        content = bytearray(valid)
        for place, value in changes:
            content[place] = value
        return bytes(content)

    return st.lists(st.tuples(places, st.integers(0, 255)), min_size=1, max_size=10).map(changed)


def truncated_and_spliced(suffix, valid):
    ends = st.integers(0, len(valid))
    again = st.just(len(valid)) if suffix == ".nc" else st.just(len(valid)) | ends
    return st.tuples(ends, st.binary(max_size=20), again).map(lambda cut: valid[: cut[0]] + cut[1] + valid[cut[2] :])


@pytest.mark.parametrize(("suffix", "kind", "share"), [
    (".asc", words, 1.0), (".csv", words, 1.0),
    *((s, *kind) for s in EXAMPLES for kind in ((random, 0.5), (mutated, 1.0), (truncated_and_spliced, 0.7))),
])  # fmt: skip
def test_bytes(folder, valid, suffix, kind, share):
    @examples(suffix, share)
    @given(kind(suffix, valid[suffix]))
    def run(content):
        read(folder, suffix, content)

    run()


def tables():
    """Tables of the right form whose numbers may be anything."""
    wild = st.floats(width=64) | st.sampled_from([0.0, 1e308, -1e308, 5e-324, np.nan, np.inf, 0.04])
    changes = st.lists(st.tuples(st.sampled_from(CHANNELS), st.integers(0, 69), wild), max_size=8)
    return st.tuples(st.integers(1, 70), changes, st.sampled_from([1.0, 1e-300, 1e300, -1.0, 0.0]))


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".parquet"])
def test_random_tables(folder, suffix):
    @examples(suffix, 0.5)
    @given(tables(), st.none() | st.sampled_from([0.04, 0.01, 0.1, 1e-9]))
    def run(table, resample):
        n, changes, scale = table
        values = {c.name: np.array(sound(70)[c.name][:n]) for c in CHANNELS}
        for channel, index, value in changes:
            values[channel.name][index % n] = value
        values["strain"] = np.linspace(-1.0, 1.0, n) * scale
        path = folder / f"table{suffix}"
        with np.errstate(over="ignore"):
            columns = [(c, values[c.name] / IN_SI[c.name]) for c in CHANNELS]
        WRITERS[suffix](columns, buffer := io.BytesIO())
        path.write_bytes(buffer.getvalue())
        with suppress(InputError):
            record = read_record(path, CHANNELS, resample=resample)
            assert record.n >= 50

    run()
