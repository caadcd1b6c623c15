"""A starter card of a file in legacy units reads its own file, once what says TODO is filled in."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "flight" / "health"))
from flights import flight

from bayes_aero.flight.card.card import parse_card
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.health.standard import standard_air
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.jobs.card.card_template import starter_card
from bayes_aero.model.derived_channels import with_sums

G, FOOT, LB, KNOT, DEG = 9.80665, 0.3048, 0.45359237, 1852.0 / 3600.0, np.pi / 180.0
SLUG, PSF = LB * G / FOOT**4, LB * G / FOOT**2
FILLED = {
    "mass": "390 slug", "Ix": "6600 slug-ft2", "Iy": "10300 slug ft^2", "Iz": "14750 SLUG-FT^2", "Ixz": "0 slug ft^2",
    "wing_area": "301 sq ft", "chord": "6.5 ft", "span": "46 ft", "tail_arm": "23 ft",
}  # fmt: skip


def columns(record):
    """Headings with their units, and the numbers in them."""
    rho = standard_air(record["altitude"])[0]
    qbar = 0.5 * rho * record["airspeed"] ** 2
    return {
        "TIME (SEC)": record.time, "TAS (KTS)": record["airspeed"] / KNOT, "ALT (FT)": record["altitude"] / FOOT,
        "AOA (DEG)": record["alpha"] / DEG, "AOS (DEG)": record["beta"] / DEG, "PITCH (DEG)": record["theta"] / DEG,
        "ROLL (DEG)": record["phi"] / DEG, "P (DEG/SEC)": record["p"] / DEG, "Q (DEG/SEC)": record["q"] / DEG,
        "R (DEG/SEC)": record["r"] / DEG, "NX (G)": record["ax"] / G, "NY (G)": record["ay"] / G,
        "NZ (G)": -record["az"] / G, "LEFT ELEVATOR (DEG)": record["elevator"] / DEG + 1.0,
        "RIGHT ELEVATOR (DEG)": record["elevator"] / DEG - 1.0, "THRUST (LBS)": 2000.0 + 9.0 * np.sin(record.time),
        "RHO (SLUG/FT3)": rho / SLUG, "QBAR (PSF)": qbar / PSF,
    }  # fmt: skip


@pytest.mark.parametrize("layout", ["brackets", "unit row"])
@pytest.mark.parametrize("density", [True, False])
def test_legacy_units_come_through(tmp_path, layout, density):
    record = flight(0, seconds=20.0)
    table = {k: x for k, x in columns(record).items() if density or not k.startswith("RHO")}
    split = [heading.rstrip(")").split(" (") for heading in table]
    first = ",".join(table) if layout == "brackets" else "\n".join(",".join(row) for row in zip(*split, strict=True))
    rows = zip(*table.values(), strict=True)
    path = tmp_path / "run.csv"
    path.write_text("\n".join([first, *(",".join(f"{x:.9g}" for x in row) for row in rows)]), encoding="utf-8")
    made = tomllib.loads(starter_card(path).text)
    todo = {key for key, value in made["aircraft"].items() if value == "TODO"}
    assert todo == set(FILLED)
    card = parse_card(made | {"aircraft": FILLED}, "made", "made.toml")
    read = read_record(path, card.channels)
    formed = with_sums(read, card)
    np.testing.assert_allclose(formed["elevator"], record["elevator"], atol=1e-8)
    np.testing.assert_allclose(formed["density"], standard_air(record["altitude"])[0], rtol=1e-6)
    np.testing.assert_allclose(formed["thrust"], (2000.0 + 9.0 * np.sin(record.time)) * LB * G, rtol=1e-6)
    np.testing.assert_allclose(formed["az"], record["az"], rtol=1e-6, atol=1e-6)
    assert ("density" in card.derived) == (not density)
    assert card.aircraft.mass == pytest.approx(390 * LB * G / FOOT)
    assert [f.sentence for f in channel_health([read], card) if f.grave] == []
