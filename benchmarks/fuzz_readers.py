"""Coverage-guided fuzzing of all that comes from other people's files: any bytes end in a result or in one sentence.

    pip install -e ".[fuzz]"                                    # Atheris, Linux
    python benchmarks/fuzz_readers.py csv --seconds 600         # asc mat parquet classic_nc card study

The tests' fuzzing (hypothesis) draws files blindly; libFuzzer keeps the inputs that reach new lines of the package.
What is found is written to --out and ends the run: an exception that is no `InputError`, a message of several lines,
a record with numbers that are not finite, more than 30 s or 4 GiB.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["bayes_aero"], enable_loader_override=False):
    import numpy as np

    from bayes_aero.errors import InputError
    from bayes_aero.flight.card.card import read_card, shipped_cards
    from bayes_aero.flight.reading.read_record import read_record, write_record
    from bayes_aero.study.study import read_study

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "flight"))
from flight_samples import CHANNELS, sound

RECORDS = {"asc": ".asc", "csv": ".csv", "mat": ".mat", "parquet": ".parquet", "classic_nc": ".nc"}
LONGEST = 1500  # characters of a sentence
STUDY = '[study]\nname = "s"\ncommand = "identify"\nrecords = ["*.csv"]\ncards = ["attas"]\nseeds = [0, 1]\n'


def _record(path: Path) -> None:
    record = read_record(path, CHANNELS)
    assert all(np.isfinite(record[name]).all() for name in record.names)


def _target(what: str, folder: Path) -> tuple[Callable[[bytes], None], list[bytes]]:
    """What reads one input, and valid inputs to begin with."""
    if what in RECORDS:
        path, read = folder / f"fuzzed{RECORDS[what]}", _record
        valid = [_valid(what, folder)]
    else:
        path, read = folder / "fuzzed.toml", read_card if what == "card" else read_study
        valid = [p.read_bytes() for p in shipped_cards().values()] if what == "card" else [STUDY.encode()]

    def one(content: bytes) -> None:
        path.write_bytes(content)
        try:
            read(path)
        except InputError as refused:
            told = str(refused)
            assert "\n" not in told, told
            assert len(told) < LONGEST, told

    return one, valid


def _valid(what: str, folder: Path) -> bytes:
    path = folder / f"valid{RECORDS[what]}"
    if what == "classic_nc":
        import xarray as xr

        record = sound(60)
        columns = {c.heading: ("t", record[c.name], {"units": "1"}) for c in CHANNELS}
        xr.Dataset(columns).to_netcdf(path, engine="scipy")
    else:
        write_record(sound(60), path, CHANNELS)
    return path.read_bytes()


def main() -> None:
    """Fuzz one kind of file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=(*RECORDS, "card", "study"))
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--out", type=Path, default=Path("fuzz"))
    asked = parser.parse_args()
    warnings.simplefilter("error")  # a warning would reach the user beside the sentence
    corpus = asked.out / asked.what
    corpus.mkdir(parents=True, exist_ok=True)
    one, valid = _target(asked.what, Path(tempfile.mkdtemp(prefix="fuzz")))
    for number, content in enumerate(valid):
        (corpus / f"valid{number}").write_bytes(content)
    limits = [f"-max_total_time={asked.seconds}", "-timeout=30", "-rss_limit_mb=4096", "-max_len=65536"]
    atheris.Setup([sys.argv[0], *limits, "-print_final_stats=1", f"-artifact_prefix={asked.out}/", str(corpus)], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
