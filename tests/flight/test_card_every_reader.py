"""A card that `card` makes passes `check` on its own file, whatever the format, once its TODO entries are filled in."""

import io

import numpy as np
import pandas as pd
import pytest
import scipy.io

from bayes_aero.flight.card.card import parse_card
from bayes_aero.flight.card.toml_tables import parse_table
from bayes_aero.flight.readers import READERS
from bayes_aero.flight.reading.inspection import inspect_record
from bayes_aero.jobs.card.card_template import starter_card

DEG, FT, G, LBF, KT = np.pi / 180.0, 0.3048, 9.80665, 4.4482216152605, 1852.0 / 3600.0
ELSEWHERE = {".ulg", ".bin"}  # logs of autopilots: their names are no aircraft's, see test_formats.py
FILLED = {"mass": "9000 kg", "wing_area": "28 m^2", "span": "14.2 m"}


def flown() -> pd.DataFrame:
    """A doublet in level flight, made of sines: what matters is that each channel is itself."""
    t = np.arange(0.0, 24.0, 0.05)
    q = 0.06 * np.sin(1.3 * t) * np.exp(-(((t - 10.0) / 5.0) ** 2))
    theta = 0.06 + np.cumsum(q) * 0.05
    alpha = 0.08 + 0.5 * (theta - theta.mean())
    speed = 110.0 + 2.0 * np.sin(0.2 * t)
    climb = speed * np.sin(theta - alpha)
    return pd.DataFrame(
        {
            "time_s": t,
            "AoA_deg": alpha / DEG,
            "theta_deg": theta / DEG,
            "phi_deg": 0.3 * np.sin(0.4 * t),
            "AOS_deg": 0.1 * np.sin(0.5 * t),
            "p_deg_s": 0.12 * np.cos(0.4 * t),
            "q_deg_s": q / DEG,
            "r_deg_s": 0.05 * np.cos(0.5 * t),
            "ax_g": np.sin(theta),
            "ay_g": 0.001 * np.sin(0.5 * t),
            "az_g": -np.cos(theta) - 3.0 * q,
            "TAS_kts": speed / KT,
            "alt_ft": (3000.0 + np.cumsum(climb) * 0.05) / FT,
            "elev_deg": -4.0 * np.gradient(q, t) / DEG,
            "thrust_lbf": 9000.0 / LBF + 10.0 * np.sin(0.1 * t),
        }
    )


def excel(frame: pd.DataFrame) -> bytes:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [list(frame), *frame.to_numpy().tolist()]:
        book.active.append(row)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def mdf(frame: pd.DataFrame, path) -> None:
    asammdf = pytest.importorskip("asammdf")
    names = [name for name in frame if name != "time_s"]
    signals = [asammdf.Signal(frame[n].to_numpy(), frame["time_s"].to_numpy(), name=n) for n in names]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals)
        file.save(path, overwrite=True)


def write(frame: pd.DataFrame, path, struct: bool) -> None:
    suffix = path.suffix
    columns = {name: frame[name].to_numpy() for name in frame}
    if suffix in (".csv", ".tsv", ".txt", ".dat", ".asc"):
        gap = {".csv": ",", ".tsv": "\t"}.get(suffix, " ")
        path.write_text(frame.to_csv(index=False, sep=gap, float_format="%.9g"))
    elif suffix == ".mat":
        scipy.io.savemat(path, {"flight": columns} if struct else columns)
    elif suffix == ".parquet":
        frame.to_parquet(path)
    elif suffix == ".nc":
        frame.to_xarray().to_netcdf(path, engine="h5netcdf")
    elif suffix == ".xlsx":
        path.write_bytes(excel(frame))
    else:
        mdf(frame, path)


@pytest.mark.parametrize(("suffix", "struct"), [(s, False) for s in READERS if s not in ELSEWHERE] + [(".mat", True)])
def test_a_starter_card_passes_on_its_own_file(tmp_path, suffix, struct):
    path = tmp_path / f"run{suffix}"
    write(flown(), path, struct)
    starter = starter_card(path)
    text = starter.text
    for key, meaning in starter.todo:
        assert key in ("mass", "Ix", "Iy", "Iz", "Ixz", "wing_area", "chord", "span", "tail_arm")
        unit = "kg m^2" if key.startswith("I") else "m"
        text = text.replace(f'{key} = "TODO"', f'{key} = "{FILLED.get(key, f"3 {unit}")}"')
        assert meaning
    card = parse_card(parse_table(text.encode(), "own"), "own", "own.toml")
    units = {channel.name: channel.unit for channel in card.channels}
    assert units["alpha"] == "deg"
    assert units["airspeed"] == "kt"
    assert units["altitude"] == "ft"
    assert units["thrust"] == "lbf"
    looked = inspect_record(path, card)
    assert looked.problems == ()
    assert looked.record is not None
    assert looked.record["airspeed"].mean() == pytest.approx(110.0, abs=0.5)
    assert looked.record["az"].mean() == pytest.approx(-G, abs=0.3)
