"""What the jobs may be told, checked: by the commands' options, by a study, by Python."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayes_aero.diagnosis.trajectories.results import Setting
from bayes_aero.diagnosis.trajectories.trajectories import WINDOW
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.writers import WRITERS, write_record
from bayes_aero.inference.validation import SplitKind
from bayes_aero.jobs.provenance import provenance, write_json
from bayes_aero.model.noise import DEFAULT as DEFAULT_NOISE
from bayes_aero.model.noise import Colour
from bayes_aero.model.observations import Forming
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.check import simulated_page
from bayes_aero.residuals.frequency_error import lines_in
from bayes_aero.simulate.demo import Request
from bayes_aero.simulate.synthetic_record import Synthetic, synthetic

SHORTEST = 1.0  # s of a window: two ends of the straight line from which the initial state is read
INITIAL_STATES = FREE, FIXED = "free", "fixed"
INPUTS = LINEAR, HELD = "linear", "held"


def check_band(
    band: tuple[float, float] | None, records: Sequence[FlightRecord], card: Card, *, flown: bool = False
) -> None:
    """Refuse a band in which a record has no frequency, and trajectories of effects, before anything is computed."""
    if band is None:
        return
    if flown and card.linear is None:
        raise InputError(
            f"trajectories are fitted in the frequency domain for linear cards only; card {card.name} has a model of "
            "effects, so use bayes-aero identify --frequency"
        )
    for record in records:
        lines_in(band, record.n, record.dt, record.name)


@dataclass(frozen=True)
class IdentifyOptions:
    """What an identification may be told.

    `coefficients` are formed from signals all filtered alike (`matched`) or as the published ones (`published`).
    With `next_flight` the manoeuvres are pooled.
    Without `sample` maximum likelihood alone stands for the parameters; without `page` no report.html is made. `split`
    chooses the split whose Gaussian-process hyperparameters are sampled; scores are given for all splits.
    `frequency`: a band, Hz, in which the parameters are fitted, too.
    """

    noise: Colour = DEFAULT_NOISE
    coefficients: str = Forming.MATCHED
    split: SplitKind = "random"
    seed: int = 0
    sample: bool = True
    gp: bool = True
    next_flight: bool = False
    figures: bool = True
    page: bool = True
    frequency: tuple[float, float] | None = None

    @property
    def forming(self) -> Forming:
        """How coefficients are formed."""
        return Forming(self.coefficients)

    @property
    def told(self) -> dict[str, Any]:
        """Those that provenance names."""
        chosen = {"noise": self.noise.value, "split": self.split, "coefficients": self.forming.value}
        return chosen | ({} if self.frequency is None else {"frequency": list(self.frequency)})


@dataclass(frozen=True)
class DiagnoseOptions:
    """What a diagnosis may be told.

    `max_effects` is the number of effects that each stage may add. `test_points` adds the manoeuvres that would decide
    what is open and the sizes of the causes in a band of frequencies, `trajectories` simulated ones. With
    `process_noise` the model is compared with innovations, in gusts, instead of coefficients; None: where the records
    are in gusts.
    """

    seed: int = 0
    max_effects: int = 8
    test_points: bool = True
    trajectories: bool = True
    figures: bool = True
    process_noise: bool | None = None


@dataclass(frozen=True)
class FlyOptions:
    """What a fit to trajectories may be told; see `jobs.fly.fly`. `process_noise` None: where the records are in
    gusts, or output error and the coefficients disagree."""

    windows: float = WINDOW
    initial_state: str = FREE
    priors: bool = True
    outputs: str | Sequence[str] | None = None
    inputs: str = LINEAR
    seed: int = 0
    figures: bool = True
    process_noise: bool | None = None
    posterior: bool = False
    frequency: tuple[float, float] | None = None  # Hz; a band in which a linear card is fitted, too
    flight_path: bool = False  # the recorded accelerations and rates are flown, not the card's model

    def __post_init__(self) -> None:
        """Refuse what cannot be flown."""
        if self.posterior and not self.filtered:
            raise InputError("a posterior is that of the fit with process noise; ask for process noise, too")
        if self.posterior and not self.priors:
            raise InputError("a posterior needs the priors; ask for one of the two only")
        if not (math.isfinite(self.windows) and self.windows >= SHORTEST):
            raise InputError(f"windows of {self.windows:g} s cannot be flown; give at least {SHORTEST:g} s")
        chosen = ("initial state", self.initial_state, INITIAL_STATES), ("inputs", self.inputs, INPUTS)
        for name, given, known in chosen:
            if given not in known:
                raise InputError(f"the setting {name} is {given!r}; use {' or '.join(known)}")

    @property
    def filtered(self) -> bool:
        """Whether process noise is fitted, if the records do not ask for it."""
        return bool(self.process_noise)

    def setting(self, card: Card) -> Setting:
        """How trajectories are fitted; what is not given is the card's."""
        own = None if self.flight_path else card.fly.outputs
        asked = own if self.outputs is None else tuple(dict.fromkeys(_names(self.outputs)))
        initial = None if self.initial_state == FREE else {} if self.flight_path else card.fly.initial_state
        return Setting(asked, initial, self.priors, self.inputs == HELD)


def _names(given: str | Sequence[str]) -> list[str]:
    """Names in a list or separated by commas."""
    return [name.strip() for name in (given.split(",") if isinstance(given, str) else given)]


# --- A simulated record on disk, with its truth beside it.

SCHEMA = "bayes_aero/truth/1"


def simulate_file(
    request: Request, card: Card, known: Mapping[str, Effect], out: Path, *, page: bool = False
) -> tuple[Synthetic, dict[str, Any], tuple[str, ...]]:
    """Simulate into `out`, in the format of its suffix, and `out`.truth.json; what is written can be read again.

    With `page` there is `out`.report.html, too; what of it cannot be made is told in the last item.
    """
    if out.suffix.lower() not in WRITERS:
        raise InputError(f"{out}: records are written as {', '.join(WRITERS)}; choose one of these suffixes")
    if not out.parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}; make it, or name another file with --out")
    found = synthetic(request, card, known, out.stem)
    record = found.record
    write_record(record, out, [c for c in card.channels if record.has(c.name)])
    try:
        read_record(out, card.channels)
    except InputError:
        out.unlink(missing_ok=True)
        raise
    asked = asdict(request) | {"duration": request.seconds}
    source = provenance(card, [record], request.seed, {k: v for k, v in asked.items() if k not in ("effects", "seed")})
    del source["inputs"]
    truth = {
        "schema": SCHEMA,
        "file": {"name": out.name, "sha256": hashlib.sha256(out.read_bytes()).hexdigest()},
        "seed": request.seed,
        "effects": {name: dict(values) for name, values in request.effects.items()},
        "parameters": dict(found.parameters),
        "disturbance": dict(found.disturbance),
        "sensor_noise": dict(found.sensor_noise),
        "notes": list(found.notes),
        "provenance": source,
    }
    write_json(truth, out.with_name(out.name + ".truth.json"))
    failures: tuple[str, ...] = ()
    if page:
        flown = [p for e in known.values() for p in e.parameters if p.name in found.parameters]
        failures = put_page(lambda: simulated_page(record, card, truth, flown), out.parent, out.name + ".report.html")
    return found, truth, failures
