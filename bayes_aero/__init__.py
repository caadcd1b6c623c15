"""Bayesian identification of non-linear aircraft aerodynamics from flight data.

The public names are those of `__all__`; each is imported at its first use.
"""

import os
import sys
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING

# The information matrix of a stall model spans ten decades; single precision loses its small eigenvalues. The variable
# is read when jax is imported, so that `bayes-aero --help` need not import it.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

# A flag that XLA does not know ends the process: these versions know the first, all know the second. With the newer
# emitters, programs that take the derivatives of all samples at once need up to six times as long on a processor. A
# loop whose passes touch less memory than the threshold, 1 kB by default, is compiled as a whole. In pieces a filter
# takes four times as long and its gradient nine times, because their calls take longer than products of small matrices.
_flags = os.environ.get("XLA_FLAGS", "")
if "xla_cpu_use_fusion_emitters" not in _flags and version("jaxlib").startswith(("0.10.", "0.11.")):
    _flags += " --xla_cpu_use_fusion_emitters=false"
if "xla_backend_extra_options" not in _flags:
    _flags += " --xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000"  # 1 MB
os.environ["XLA_FLAGS"] = _flags.strip()

__version__ = "0.1.0"

_PUBLIC = {
    "api": "Diagnosed Fit diagnose fit gpr next_flight plot read sample", "effect": "Effect Stage",
    "effects": "CATALOGUE", "errors": "InputError", "flight.card": "Card read_card",
    "flight.record": "FlightRecord write_record", "jobs.fly": "flight_path fly",
    "model.model": "Model", "parameter": "Parameter Prior",
}  # fmt: skip
_HOME = {name: module for module, names in _PUBLIC.items() for name in names.split()}

if TYPE_CHECKING:
    from bayes_aero.api import Diagnosed, Fit, diagnose, fit, gpr, next_flight, plot, read, sample
    from bayes_aero.effect import Effect, Stage
    from bayes_aero.effects import CATALOGUE
    from bayes_aero.errors import InputError
    from bayes_aero.flight.card import Card, read_card
    from bayes_aero.flight.record import FlightRecord, write_record
    from bayes_aero.jobs.fly import flight_path, fly
    from bayes_aero.model.model import Model
    from bayes_aero.parameter import Parameter, Prior

__all__ = [
    "CATALOGUE", "Card", "Diagnosed", "Effect", "Fit", "FlightRecord", "InputError", "Model", "Parameter", "Prior",
    "Stage", "__version__", "diagnose", "fit", "flight_path", "fly", "gpr", "next_flight", "plot", "read", "read_card",
    "sample", "write_record",
]  # fmt: skip


def __getattr__(name: str) -> object:
    """Import a public name at its first use: `import bayes_aero` itself stays cheap and free of cycles."""
    if name not in _HOME:
        raise AttributeError(f"module 'bayes_aero' has no attribute {name!r}")
    value = getattr(import_module(f"bayes_aero.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
