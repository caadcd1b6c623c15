"""Every number of the results of a fixed set of runs, kept to tell whether a change of the code moves one.

    python benchmarks/golden.py keep [--only TEXT]       # write benchmarks/golden/*.csv.gz
    python benchmarks/golden.py compare [--only TEXT]    # run again; print what moved by more than 1e-6; exit 1 if any

Records that are not there (`../shared`) are left out and named. Sentences that changed are counted, not judged.
Nothing is sampled: a chain turns the last digit of a sum into other draws.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
import json
import math
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests"))
KEPT = HERE / "golden"
SHARED = HERE.parents[1] / "shared"
SAME = 1e-6  # relative; absolute below one
HIDDEN = (
    "thrust_moment=0.8", "alpha_squared_moment.Cma2=0.8", "alpha_dot_moment=-6", "pitch_rate_lift=8",
    "alpha_bias=0.8 deg", "alpha_scale=0.05", "airspeed_scale=0.03", "pitch_rate_bias=0.3 deg/s", "accel_x_bias=0.15",
    "elevator_delay=0.08", "thrust_lift=0.5", "elevator_lift=0.4", "separated_elevator=0.6", "thrust_scale=0.12",
    "thrust_lag=1.5", "mass_scale=0.06", "alpha_delay=0.1", "vertical_wind=1.5", "separation_lag.tau1=20",
    "pitch_attitude_bias=0.8 deg",
)  # fmt: skip
WITHOUT_ACCELEROMETERS = {1, 6, 15, 18}  # these flights are diagnosed by trajectories
IN_FULL = {0, 3}  # with test points and trajectories
ACCELEROMETERS = re.compile(r"^(ax|ay|az) = .*\n", re.MULTILINE)


def cases(work: Path) -> Iterator[tuple[str, list[str]]]:
    """Names and arguments of the commands; simulated records are written into `work`."""
    yield "demo_identify", ["identify", "--no-gp", "--no-sample", "--no-figures"]
    yield "demo_diagnose", ["diagnose", "--no-figures"]
    stalls = [str(SHARED / "attas" / f"fAttas_qst0{k}.asc") for k in (1, 2)]
    yield "attas_identify", ["identify", *stalls, "--no-gp", "--no-sample", "--no-figures"]
    yield "attas_diagnose", ["diagnose", *stalls, "--no-figures"]
    yield "attas_fly", ["fly", *stalls, "--no-figures"]
    book = {
        "attas_lateral": ["fAttasAilRud1.asc"],
        "attas_roll_yaw": ["fAttasAilRud1.mat@50:80", "fAttasAilRud1.mat@110:140"],
        "hfb320": ["hfb320_1_10.asc"],
        "unstable": ["unStabAC_sim.asc"],
        "attas_short_period": ["fAttasElv1.mat", "fAttasElv2.mat"],
    }
    for card, names in book.items():
        files = [str(SHARED / "book" / name) for name in names]
        yield f"{card}_fly", ["fly", *files, "--model", card, "--split", "--no-figures"]
    yield "hfb320_diagnose", ["diagnose", str(SHARED / "book" / "hfb320_1_10.asc"), "--model", "hfb320", "--no-figures"]
    yield "six_axes_diagnose", six_axes(work)
    card = work / "no_accelerometers.toml"
    for number, effect in enumerate(HIDDEN):
        name, model, options = effect.split("=")[0].split(".")[0], "attas", ["--no-figures"]
        if number not in IN_FULL:
            options += ["--no-test-points", "--no-trajectories"]
        if number in WITHOUT_ACCELEROMETERS:
            from bayes_aero.flight.card import shipped_cards

            card.write_text(ACCELEROMETERS.sub("", shipped_cards()["attas"].read_text()))
            model, options = str(card), ["--no-figures"]
        files = [str(work / f"{name}_{k}.csv") for k in (1, 2)]
        for k, file in enumerate(files):
            written = ["--duration", "45", "--noise", ("buffet", "ar1")[number % 2], "--out", file]
            code, text = said(["simulate", "--effect", effect, "--seed", str(100 + 2 * number + k), *written])
            if code:
                sys.exit(text)
        yield f"hidden_{name}", ["diagnose", *files, "--model", model, *options]


def six_axes(work: Path) -> list[str]:
    """Diagnosis of another simulator's aircraft in six degrees of freedom; its card lacks the roll by the rudder."""
    import numpy as np
    import pandas as pd
    from six_axes import LATERAL, LONGITUDINAL, card_text, recorded
    from stranger_six import Plane, fly

    rng, plane, files = np.random.default_rng(9), Plane(), []
    for kind in ("elevator", "aileron", "rudder"):
        files.append(str(work / f"six_{kind}.csv"))
        pd.DataFrame(recorded(fly(plane, kind, rng, seconds=20.0), rng)).to_csv(files[-1], index=False)
    card = work / "six.toml"
    effects = tuple(name for name in (*LONGITUDINAL, *LATERAL) if name != "rudder_roll")
    card.write_text(card_text(plane, effects), encoding="utf-8")
    return ["diagnose", *files, "--model", str(card), "--no-figures"]


def said(arguments: list[str]) -> tuple[int, str]:
    """Exit code and output of a command, in this process."""
    from calling import called

    done = called(HERE.parent, *arguments)
    return done.code, done.out + done.err


def leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every number, text and truth of a JSON document with the way to it."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key not in ("provenance", "schema"):
                yield from leaves(value, f"{path}/{key}")
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from leaves(value, f"{path}/{i}")
    else:
        yield path, node


def numbers(arguments: list[str], out: Path) -> dict[str, str]:
    """What a command writes, by file and place in it."""
    code, text = said([*arguments, "--out", str(out)])
    found = {"exit": repr(code)}
    if code not in (0, 1, 3):
        found["error"] = text
    for file in sorted(out.glob("*.json")):
        for place, value in leaves(json.loads(file.read_text(encoding="utf-8"))):
            text = value.replace(str(out.parent), "") if isinstance(value, str) else value
            found[f"{file.name}{place}"] = f"{text:.9g}" if isinstance(text, float) else json.dumps(text)
    return found


def sentence(value: str | None) -> bool:
    """Whether a value is a text in words, not a name or a number."""
    return value is not None and value.startswith('"') and " " in value


def moved(old: str | None, new: str | None) -> bool:
    """Whether two values differ by more than `SAME`."""
    if old is None or new is None:
        return True
    try:
        a, b = float(old), float(new)
    except ValueError:
        return old != new
    return not (math.isclose(a, b, rel_tol=SAME, abs_tol=SAME * min(1.0, abs(a) + 1e-3)) or (a != a and b != b))


def main_() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("keep", "compare"))
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    KEPT.mkdir(exist_ok=True)
    differences = 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for name, arguments in cases(work):
            if not re.search(given.only, name):
                continue
            if missing := [a for a in arguments if a.startswith(str(SHARED)) and not Path(a.split("@")[0]).exists()]:
                print(f"{name}: left out, there is no {missing[0]}")
                continue
            begun = time.perf_counter()
            found = numbers(arguments, work / name)
            took = f"{time.perf_counter() - begun:.0f} s"
            path = KEPT / f"{name}.csv.gz"
            if given.what == "keep":
                with gzip.GzipFile(path, "wb", mtime=0) as raw, io.TextIOWrapper(raw, newline="") as file:
                    csv.writer(file).writerows(found.items())
                print(f"{name}: {len(found)} values, {path.stat().st_size} bytes, {took}", flush=True)
                continue
            with gzip.open(path, "rt", newline="") as file:
                old = dict(csv.reader(file))
            apart = [k for k in {**old, **found} if moved(old.get(k), found.get(k))]
            texts = [k for k in apart if sentence(old.get(k)) or sentence(found.get(k))]
            numbers_apart = [k for k in apart if k not in texts]
            differences += len(numbers_apart)
            print(f"{name}: {len(numbers_apart)} of {len(old)} differ, {len(texts)} sentences, {took}", flush=True)
            for key in numbers_apart[:40]:
                print(f"    {key}: {old.get(key)} -> {found.get(key)}")
    return int(differences > 0)


if __name__ == "__main__":
    sys.exit(main_())
