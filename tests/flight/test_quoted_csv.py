"""CSV files with quoted cells that hold the separator: headings, decimal commas, and what cannot be told."""

from __future__ import annotations

import re

import numpy as np
import pytest
from flight_samples import told

from bayes_aero.flight.channel import Channel
from bayes_aero.flight.reading.raw import read_raw
from bayes_aero.flight.reading.read_record import read_record

QUOTED = (Channel("time", "s", "T"), Channel("alpha", "deg", "alpha, left vane"), Channel("altitude", "m", "H"))


def quoted_file(folder):
    """Commas between 60 rows' cells, and decimal ones within quotes."""
    rows = [f'"{0.04 * i:.2f}","{0.5 + 0.01 * i:.2f}","{5000 + i}"' for i in range(60)]
    path = folder / "quoted.csv"
    path.write_text("\n".join(['T,"alpha, left vane",H', *(row.replace(".", ",") for row in rows)]))
    return path


def test_a_header_and_numbers_with_commas_in_quotes(tmp_path):
    record = read_record(quoted_file(tmp_path), QUOTED)
    np.testing.assert_allclose(record.time, 0.04 * np.arange(60), atol=1e-12)
    np.testing.assert_allclose(record["alpha"], np.deg2rad(0.5 + 0.01 * np.arange(60)), rtol=1e-12)
    assert record["altitude"][-1] == 5059.0
    labels = [column.label for column in read_raw(tmp_path / "quoted.csv").columns]
    assert labels == ["T", "alpha, left vane", "H"]


def test_thousands_are_never_taken_for_decimals(tmp_path):
    """ "5,000" is five thousand where points stand before decimals, and cannot be told where nothing else speaks."""
    path = quoted_file(tmp_path)
    rows = path.read_text().splitlines()
    points = [re.sub(r'"(\d),', r'"\1.', row).replace('"50', '"5,0') for row in rows[1:]]
    path.write_text("\n".join([rows[0], *points]))
    assert read_record(path, QUOTED)["altitude"][0] == 5000.0
    path.write_text("\n".join(["T,H", *(f'{i},"5,{i:03d}"' for i in range(60))]))
    told(path, (QUOTED[0], QUOTED[2]), "'5,059'", "decimal comma", "thousands")
    path.write_text("\n".join(["T,H", *(f'{i},"0,{i:03d}"' for i in range(60))]))  # no thousands begin with 0
    assert read_record(path, (QUOTED[0], QUOTED[2]))["altitude"][59] == 0.059


@pytest.mark.parametrize("row", [0, 1, 30, 60])
def test_a_quote_that_is_not_closed(tmp_path, row):
    path = quoted_file(tmp_path)
    lines = path.read_text().splitlines()
    at = lines[row].rindex('"')
    lines[row] = lines[row][:at] + lines[row][at + 1 :]
    path.write_text("\n".join(lines))
    told(path, QUOTED, f"line {row + 1} has a quote that is not closed", "close it")


def test_errors_in_quoted_files_name_the_column_in_the_file(tmp_path):
    path = quoted_file(tmp_path)
    lines = path.read_text().splitlines()
    lines[20] = '"0,76","a, b",5019'
    path.write_text("\n".join(lines))
    told(path, QUOTED, "channel alpha", "line 21", "column 2", "sample 19")
    lines[20] = '"0,76","0,69"'
    path.write_text("\n".join(lines))
    told(path, QUOTED, "line 21", "2 columns where 3")
