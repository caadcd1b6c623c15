"""The options of the commands, once: command line, Python keywords, studies and the JSON's settings come from here.

Nothing heavy is imported: --help and a study's file need these alone.
"""

# ruff: noqa: RUF009 - `option` makes a field
from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import wraps
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar, get_args, get_type_hints

from bayes_aero.errors import InputError

NoiseName = Literal["white", "ar1", "buffet-ar1"]  # `model.observations.Colour`
FormingName = Literal["matched", "published"]  # `model.observations.Forming`
SplitName = Literal["random", "block", "manoeuvre"]  # `inference.gp.SplitKind`
InitialStateName = Literal["free", "fixed"]
InputsName = Literal["linear", "held"]
ExportForm = Literal["jsbsim", "fmu", "tables"]
FREE, FIXED = get_args(InitialStateName)
LINEAR, HELD = get_args(InputsName)

SHORTEST = 1.0  # s of a window: two ends of the straight line from which the initial state is read
WHOLE = 1e6  # s: no windows; integrated accelerations stay near the measured path from the start
DRAWS, FEWEST, MOST_DRAWS = 400, 100, 10_000  # of a qualification: with fewer no probability is decided
MOST_GUSTS = 20.0  # m/s
MAX_SEED = 2**32 - 1  # that every generator takes

Names = str | Sequence[str] | None  # a list, or separated by commas as on a command line
Job = TypeVar("Job", bound=Callable[..., Any])


def option(default: Any, help: str = "", *, name: str | None = "", kind: Any = None, **row: Any) -> Any:
    """A field that is an option, with `help`; on the command line it has another `name` (None: it is none there) and
    `kind` where the field's do not serve, and `row`: `min`, `max`, `metavar`, `flag` (a switch without its --no-)."""
    return field(default=default, metadata={"help": help, "name": name, "kind": kind, "row": row})


def _seed() -> Any:
    return option(0, "Same seed, same command, same machine: same numbers.", min=0, max=MAX_SEED)


def _frequency() -> Any:
    help = "Hz: fit in the frequency domain, too, in this band, where bias and drift drop out."
    return option(None, help, metavar="LOW HIGH")


class Options:
    """Options of one command as a dataclass whose fields are made by `option`."""

    SETTINGS: ClassVar[tuple[str, ...]] = ()  # on which the numbers rest: provenance names them
    APART: ClassVar[tuple[str, ...]] = ("seed",)  # that a study does not state under [options]

    @property
    def settings(self) -> dict[str, Any]:
        """Those on which the numbers rest; what was left to the program is absent."""
        return {n: list(x) if isinstance(x, tuple) else x for n in self.SETTINGS if (x := getattr(self, n)) is not None}

    @classmethod
    def kinds(cls) -> dict[str, Any]:
        """The type of each option as it is written on a command line or in a study."""
        hints = {f.name: f.metadata["kind"] or get_type_hints(cls)[f.name] for f in fields(cls)}  # type: ignore[arg-type]
        return {name: str | None if hint == Names else hint for name, hint in hints.items()}


@dataclass(frozen=True)
class ReadingOptions(Options):
    """The card, and how records are read."""

    APART = ("model",)
    model: str = option("attas", "Card: a .toml file, or a shipped one by name.", metavar="CARD")
    resample: float | None = option(None, "Interpolate records with uneven or several rates to this time step in s.")
    split: bool = option(False, "Gaps in time divide a file into manoeuvres.", flag=True)


@dataclass(frozen=True)
class IdentifyOptions(Options):
    """What an identification may be told; each option says what it is."""

    SETTINGS = ("noise", "split", "coefficients", "frequency")
    APART = ("seed", "noise", "split")
    seed: int = _seed()
    noise: NoiseName = option("buffet-ar1", "Noise model of the posterior.")
    coefficients: FormingName = option("matched", "Same filter for all signals (matched), or as the published results.")
    split: SplitName = option("random", "Split whose Gaussian-process hyperparameters are sampled.", name="gp_split")
    frequency: tuple[float, float] | None = _frequency()
    sample: bool = option(True, "Sample the posterior; otherwise maximum likelihood with its bounds only.")
    gp: bool = option(True, "Train the Gaussian processes.")
    next_flight: bool = option(False, "Pool the manoeuvres: scatter between them, and the next flight.", flag=True)
    figures: bool = option(True, "Draw the figures.")
    page: bool = option(True, name=None)


@dataclass(frozen=True)
class DiagnoseOptions(Options):
    """What a diagnosis may be told; each option says what it is."""

    SETTINGS = ("max_effects", "process_noise", "anyway")
    seed: int = _seed()
    max_effects: int = option(8, "Effects that each stage may add to the model.", min=1)
    test_points: bool = option(True, "Propose manoeuvres that decide what is open; fit causes in a band.")
    trajectories: bool = option(True, "Simulate the card's and the extended model with the recorded inputs.")
    figures: bool = option(True, "Draw the figures.")
    process_noise: bool | None = option(None, "Estimate gusts, search in innovations; default: if there are gusts.")
    anyway: bool = option(False, "Go on where sensors contradict each other beyond the tolerances.", flag=True)


@dataclass(frozen=True)
class FlyOptions(Options):
    """What a fit to trajectories may be told.

    Attributes:
        windows: length in s of the windows that are fitted before whole manoeuvres.
        initial_state: "free", fitted for each manoeuvre, or "fixed": the card's ([fly] initial_state), and where it
            names none the first sample.
        priors: False omits all priors from the reported fit, including those of free initial states.
        outputs: names of the outputs that are compared, a list or separated by commas; default: the card's ([fly]
            outputs), and without these all recorded ones but altitude and q_dot.
        inputs: "linear" between samples, or "held" until the next one.
        process_noise: True fits the same model with process noise, too, by an extended Kalman filter; None: if the
            flight path of a record shows gusts, or if output error and the coefficients disagree.
        posterior: True also samples the posterior of the fit with process noise, by emcee and NUTS.
        frequency: lowest and highest frequency, Hz, of a band in which a linear card is fitted, too, by equation error
            and output error.
        seed: of the fit of the coefficients.
        figures: False draws none.
        flight_path: the recorded accelerations and rates are flown, not the card's model.
    """

    SETTINGS = ("windows", "initial_state", "priors", "inputs", "posterior", "process_noise", "frequency")
    APART = ("seed", "flight_path")
    windows: float = option(12.0, "Length of the windows that are fitted before whole manoeuvres, in s.")
    initial_state: str = option(FREE, "free: fitted; fixed: the card's, or the first sample.", kind=InitialStateName)
    priors: bool = option(True, "--no-priors: a fit without priors of parameters and initial states.")
    outputs: Names = option(None, "Outputs to compare; default: the card's, or all but q_dot.", metavar="NAME,NAME")
    inputs: str = option(LINEAR, "Inputs between samples: linear, or held until the next one.", kind=InputsName)
    process_noise: bool | None = option(None, "Fit with process noise, too; default: in gusts, or if fits disagree.")
    posterior: bool = option(False, "With --process-noise: sample the posterior, too (NUTS and emcee).", flag=True)
    frequency: tuple[float, float] | None = _frequency()
    seed: int = _seed()
    figures: bool = option(True, "Draw the figures.")
    flight_path: bool = option(False, name=None)

    def __post_init__(self) -> None:
        if self.posterior and not self.process_noise:
            raise InputError("a posterior is that of the fit with process noise; ask for process noise, too")
        if self.posterior and not self.priors:
            raise InputError("a posterior needs the priors; ask for one of the two only")
        if not (math.isfinite(self.windows) and self.windows >= SHORTEST):
            raise InputError(f"windows of {self.windows:g} s cannot be flown; give at least {SHORTEST:g} s")
        for name in ("initial_state", "inputs"):
            choices, given = get_args(self.kinds()[name]), getattr(self, name)
            if given not in choices:
                raise InputError(f"the setting {name.replace('_', ' ')} is {given!r}; use {' or '.join(choices)}")


@dataclass(frozen=True)
class PathOptions(Options):
    """What a reconstruction of the flight path may be told.

    Attributes:
        initial_state: "free", fitted for each manoeuvre, or "fixed": the first sample.
        priors: False omits all priors.
        outputs: names of the outputs that are compared, a list or separated by commas; default: all that were recorded
            of airspeed, flow angles, attitude, heading and altitude.
        process_noise: True fits again with gusts and noise of the states, by an extended Kalman filter.
        figures: False draws none.
    """

    initial_state: InitialStateName = option(FREE, "free: fitted for each manoeuvre; fixed: the first sample.")
    priors: bool = option(True, "--no-priors: a fit without priors.")
    outputs: Names = option(None, "Outputs to compare; default: all recorded.", metavar="NAME,NAME")
    process_noise: bool = option(False, "Fit again with gusts and process noise (a Kalman filter).", flag=True)
    figures: bool = option(True, "Draw the figures.")

    @property
    def fly(self) -> FlyOptions:
        return FlyOptions(WHOLE, flight_path=True, **vars(self))


@dataclass(frozen=True)
class QualifyOptions(Options):
    """What a qualification may be told; `fitted` are files of the records of the result."""

    card: str | None = option(None, "The card of the result, where it is not found.", name="model", metavar="CARD")
    fitted: tuple[Path, ...] = option((), "A record of the result; once for each.", kind=list[Path] | None)
    draws: int = option(DRAWS, "Flights drawn for every test.")
    gusts: float | None = option(None, "Intensity of gusts, m/s; default: those that fly has estimated.")
    seed: int = _seed()

    def __post_init__(self) -> None:
        if not FEWEST <= self.draws <= MOST_DRAWS:
            raise InputError(f"--draws is {self.draws}; give a number from {FEWEST} to {MOST_DRAWS}")
        if self.gusts is not None and not 0.0 <= self.gusts <= MOST_GUSTS:
            raise InputError(f"--gusts is {self.gusts:g} m/s; give a number from 0 to {MOST_GUSTS:g}")


def keywords(kind: type[Options]) -> Callable[[Job], Job]:
    """For a job of records, card and options: the fields of `kind`, its options, may be given by keyword instead."""
    keys = {n: p for n, p in inspect.signature(kind).parameters.items() if n != "flight_path"}

    def of(job: Job) -> Job:
        @wraps(job)
        def run(records: Any, card: Any, options: Options | None = None, **given: Any) -> Any:
            settings = {name: given.pop(name) for name in keys if name in given}
            if settings and options is not None:
                raise TypeError(f"{job.__name__}() has its options in one or by keyword, not both")
            return job(records, card, options or kind(**settings), **given)

        signature = inspect.signature(job)
        parameters = [*signature.parameters.values(), *(p.replace(kind=p.KEYWORD_ONLY) for p in keys.values())]
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return run  # type: ignore[return-value]

    return of
