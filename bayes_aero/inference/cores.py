"""How many cores this process may keep busy."""

from __future__ import annotations

import os

from joblib import cpu_count

VARIABLE = "BAYES_AERO_CORES"


def cores() -> int:
    """Those that the variable BAYES_AERO_CORES allows, else all that the system allows this process.

    A worker of a cluster is given one: the other cores belong to its neighbours.
    """
    allowed = os.environ.get(VARIABLE, "")
    return max(1, int(allowed)) if allowed.isdecimal() else cpu_count()
