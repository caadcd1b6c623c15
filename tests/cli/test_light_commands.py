"""Commands that answer in seconds load no library that takes seconds: neither JAX nor what draws or samples."""

import json
import subprocess
import sys

import numpy as np
import pytest

HEAVY = ("jax", "equinox", "numpyro", "arviz_base", "matplotlib", "pandas", "xarray", "scipy.stats", "scipy.signal")
TOLD = f"""
import json, sys
from bayes_aero.cli import main
try:
    main()
except SystemExit as stopped:
    print(json.dumps([stopped.code or 0, [m for m in {HEAVY!r} if m in sys.modules]]), file=sys.stderr)
"""
CARD = """
title = "a glider"
[aircraft]
mass = "500 kg"
Ix = "1500 kg m^2"
Iy = "1000 kg m^2"
Iz = "2500 kg m^2"
Ixz = "0 kg m^2"
wing_area = "11 m^2"
chord = "0.75 m"
half_span = "7.5 m"
aspect_ratio = 20.0
tail_arm = "4 m"
[channels]
time = { label = "t", unit = "s" }
ax = { label = "ax", unit = "m/s^2" }
az = { label = "az", unit = "m/s^2" }
q = { label = "q", unit = "rad/s" }
theta = { label = "theta", unit = "rad" }
alpha = { label = "alpha", unit = "rad" }
airspeed = { label = "V", unit = "m/s" }
[constants]
density = "1 kg/m^3"
thrust = "0 N"
p = "0 rad/s"
r = "0 rad/s"
[model]
effects = ["attached_lift", "profile_drag"]
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A steady climb with noise, and its card."""
    folder = tmp_path_factory.mktemp("light")
    rng, n = np.random.default_rng(0), 400
    steady = {"ax": 9.80665 * np.sin(0.1), "az": -9.80665 * np.cos(0.1), "q": 0.0, "theta": 0.1, "alpha": 0.05, "V": 30}
    noise = {"ax": 0.01, "az": 0.02, "q": 1e-4, "theta": 1e-3, "alpha": 1e-3, "V": 0.1}
    columns = [0.1 * np.arange(n), *(x + noise[name] * rng.standard_normal(n) for name, x in steady.items())]
    header = ",".join(["t", *steady])
    np.savetxt(folder / "climb.csv", np.stack(columns, axis=1), delimiter=",", header=header, comments="")
    (folder / "glider.toml").write_text(CARD)
    (folder / "study.toml").write_text("nonsense = 1")
    return folder


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        (0, ["check", "climb.csv", "--model", "glider.toml"]),
        (0, ["check", "climb.csv", "--model", "glider.toml", "--out", "checked"]),
        (0, ["card", "climb.csv", "--out", "new.toml"]),
        (2, ["check", "climb.csv", "--model", "nosuch"]),
        (2, ["identify", "climb.csv", "--model", "attas"]),
        (2, ["diagnose", "nosuch.csv"]),
        (2, ["fly", "climb.csv", "--model", "attas"]),
        (2, ["run", "study.toml"]),
        (2, ["export", "nosuch", "--to", "jsbsim"]),
        (2, ["open", "nosuch"]),
    ],
)
def test_nothing_heavy_is_loaded(files, code, arguments):
    done = subprocess.run(
        [sys.executable, "-c", TOLD, *arguments], cwd=files, capture_output=True, text=True, check=False
    )
    found = json.loads(done.stderr.splitlines()[-1])
    assert found == [code, []], done.stderr
