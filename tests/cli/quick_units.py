"""Preloaded into workers: units that take a moment, with their own numbers; "deadly" ones kill the process."""

import hashlib
import os
import signal
import time
from pathlib import Path

import numpy as np

from bayes_aero.jobs.store import provenance, write_json
from bayes_aero.study import run as units

SECONDS = float(os.environ.get("QUICK_SECONDS", "0.4"))


def quick(unit, out, *_):
    """Parameters drawn from the record and the seed, and 300 kB of samples."""
    if "deadly" in unit.records[0]:
        os.kill(os.getpid(), signal.SIGKILL)
    number = int(hashlib.sha256(Path(unit.records[0]).read_bytes()).hexdigest()[:6], 16)
    rng = np.random.default_rng([number, unit.seed])
    time.sleep(SECONDS / 2)
    np.save(out / "samples.npy", rng.normal(size=37_500))
    time.sleep(SECONDS / 2)
    parameters = {"CLa": {"estimate": rng.normal(), "crb": 0.1, "crb_corrected": 0.2, "unit": "1/rad"}}
    source = provenance(units.card_of(unit), [], unit.seed, unit.settings)
    write_json({"mle": {"status": "converged", "parameters": parameters}, "provenance": source}, out / "results.json")


units.run_task = quick
