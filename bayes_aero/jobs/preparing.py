"""What comes before a fit: effects by name, effect files, simulated records, a starter card for a new aircraft."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_aero.atomic_write import write_whole
from bayes_aero.effect import Effect
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import ATMOSPHERE, RULES, Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, split_heading
from bayes_aero.flight.columns import Guess, guessed
from bayes_aero.flight.health import noise_of, quantum
from bayes_aero.flight.reading import MIN_SAMPLES, RawColumn, read_raw, read_record
from bayes_aero.flight.record import WRITERS, write_record
from bayes_aero.jobs.store import picked, provenance, sha256_of, write_json
from bayes_aero.model.model import effect_named, own_effects
from bayes_aero.physics.aircraft import AIRCRAFT_KEYS, FORMED_FROM, REQUIRED, Axis
from bayes_aero.units import canonical, from_si, quantity_to_si

if TYPE_CHECKING:  # what computes and draws is heavy
    from bayes_aero.diagnosis.result import FoundTerm
    from bayes_aero.simulate.demo import Request
    from bayes_aero.simulate.injection import Synthetic


def known_effects(card: Card | None = None) -> dict[str, Effect]:
    card_effects = own_effects(card.effect_files) if card is not None else {}
    return dict(sorted((CATALOGUE | card_effects).items()))


def effect_facts(effect: Effect, card: Card | None = None) -> dict[str, Any]:
    """An effect as plain data; `model` says whether the card's model has it, null without a card."""
    parameters = []
    for p in effect.parameters:
        least, most = effect.sizes.get(p.name, (None, None))
        prior = picked(p.prior, "family", "location", "scale", "source", "text")
        about = picked(p, "name", "unit", "description", "neutral", "start", "bounds")
        parameters.append(about | {"prior": prior, "least_worth_modelling": least, "largest_plausible": most})
    return {
        "name": effect.name,
        "kind": effect.kind.value,
        "stage": effect.stage.name.lower(),
        **picked(effect, "claim", "formula"),
        "parameters": parameters,
        **picked(effect, "needs=channels", "rests_on=uses"),
        "axes": [axis.value for axis in effect.axes],
        "proposed_by_diagnose": effect.candidate and (card is None or effect.acts_on(card.axes)),
        "example": picked(effect.example, "parameters", "signals", "known", "increments", "source")
        | {"known": effect.example.known or {}},
        "source": effect.source,
        "model": None if card is None else effect.name in card.effects,
    }


# --- An effect file of the terms that a diagnosis found, for a card to name.

HEAD = '''"""Terms that bayes-aero diagnose found in {records}."""

from bayes_aero import Effect, Parameter, Prior, Stage
{imports}from bayes_aero.effect import Example, Kind
'''
IMPORTED = {
    "xp.": "from bayes_aero.arrays import xp\n",
    "reduced(": "from bayes_aero.physics.kinematics import reduced\n",
    "reduced_lateral(": "from bayes_aero.physics.kinematics import reduced_lateral\n",
}
TERM = '''

def _{name}(v, s, a, known):
    """{coefficient} += {parameter} {term}."""
    return {{"{coefficient}": v["{parameter}"] * {code}}}


{constant} = Effect(
    name="{name}",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="{coefficient} has a term {term}.",
    parameters=(Parameter("{parameter}", "{unit}", 0.0, 0.0, "factor of {term}", Prior("normal", 0.0, {largest!r})),),
    channels={channels!r},
    increments=_{name},
    example=Example({{"{parameter}": 0.0}}, {{}}, {{"{coefficient}": 0.0}}, "neutral: it adds nothing"),
    source="found in {records}: {size:.4g} with a standard error of {sd:.2g}",
    sizes={{"{parameter}": ({least!r}, {largest!r})}},
)
'''
LARGEST = 5.0  # times what was found, the largest plausible factor; our choice


def refuse_existing(path: Path) -> None:
    if path.exists():
        raise InputError(f"{path} exists; give another name to --write-effect")
    if path.suffix != ".py":
        raise InputError(f"{path}: an effect file is Python; give --write-effect a name that ends in .py")


def write_effects(terms: Sequence[FoundTerm], records: Sequence[str], path: Path) -> str:
    """Write the terms of a diagnosis that an effect file can state, and say what was written in a sentence."""
    stated = [term for term in terms if term.term.code is not None]
    if not stated:
        return f"No term was found that an effect file can state, so {path} was not written."
    try:
        write_whole(effect_file(stated, records), path)
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}); give --write-effect another name") from None
    return f"{path} has {len(stated)} effect{'s' * (len(stated) > 1)}; name it under [model] effect_files of the card."


def effect_file(terms: Sequence[FoundTerm], records: Sequence[str]) -> str:
    sources = re.sub(r"[^\w.@:+ -]", "_", " and ".join(records))  # a name becomes part of a program
    code = " ".join(term.term.code or "" for term in terms)
    parts = [HEAD.format(records=sources, imports="".join(line for used, line in IMPORTED.items() if used in code))]
    for term in terms:
        plain = term.term.name.lower().replace("(1 - x)", "separated").replace("^", "").replace("+", "plus")
        name, (size, sd) = f"{term.coefficient}_{re.sub(r'[^a-z0-9]+', '_', plain).strip('_')}", term.size
        largest = LARGEST * max(abs(size), term.least)
        names = {"name": name.lower(), "constant": name.upper(), "parameter": name, "coefficient": term.coefficient}
        about = {"term": term.term.name, "unit": term.term.unit, "code": term.term.code, "channels": term.term.channels}
        sizes = {"size": size, "sd": sd, "least": float(f"{term.least:.3g}"), "largest": float(f"{largest:.3g}")}
        parts.append(TERM.format(**names, **about, **sizes, records=sources))
    return "".join(parts)


# --- The job of `bayes-aero simulate`: a record on disk, with its truth beside it.


def simulate_file(
    request: Request, card: Card, catalogue: Mapping[str, Effect], out: Path
) -> tuple[Synthetic, dict[str, Any]]:
    """Simulate into `out`, in the format of its suffix, and `out`.truth.json; what is written can be read again."""
    from bayes_aero.simulate.injection import synthetic

    if out.suffix.lower() not in WRITERS:
        raise InputError(f"{out}: records are written as {', '.join(WRITERS)}; choose one of these suffixes")
    if not out.parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}; make it, or name another file with --out")
    simulated = synthetic(request, card, catalogue, out.stem)
    record = simulated.record
    write_record(record, out, [c for c in card.channels if record.has(c.name)])
    try:
        read_record(out, card.channels)
    except InputError:
        out.unlink(missing_ok=True)
        raise
    fields = asdict(request) | {"duration": request.seconds}
    source = provenance(card, [record], request.seed, {k: v for k, v in fields.items() if k not in ("effects", "seed")})
    del source["inputs"]
    truth = {
        "schema": "bayes_aero/truth/1",
        "file": {"name": out.name, "sha256": sha256_of(out)},
        "seed": request.seed,
        "effects": request.effects,
        **picked(simulated, "parameters", "disturbance", "sensor_noise", "notes"),
        "provenance": source,
    }
    write_json(truth, out.with_name(out.name + ".truth.json"))
    return simulated, truth


# --- Effects as they are asked for on the command line and in studies: "NAME=VALUE" or "NAME.PARAMETER=VALUE".


def parsed_effects(given: Sequence[str], catalogue: Mapping[str, Effect]) -> dict[str, dict[str, float]]:
    """True values by effect and parameter, in SI; a value may carry a unit, "pitch_rate_bias=0.2 deg/s"."""
    from bayes_aero.simulate.demo import TRUTH

    effects: dict[str, dict[str, float]] = {}
    for text in given:
        left, equals, right = text.partition("=")
        name, _, wanted = left.strip().partition(".")
        if not equals or not right.strip():
            raise InputError(f"--effect {text!r} has no value; write NAME=VALUE, e.g. pitch_rate_bias=0.01")
        parameters = {p.name: p for p in effect_named(name, catalogue).parameters}
        if not parameters:
            raise InputError(f"--effect {text!r}: {name} has no parameter, so there is nothing to set")
        if wanted not in parameters and (wanted or len(parameters) > 1):
            names = " and ".join(f"{name}.{p}=VALUE" for p in parameters)
            has = f"has no parameter {wanted}" if wanted else f"has {len(parameters)} parameters"
            raise InputError(f"--effect {text!r}: {name} {has}; write {names}")
        parameter = parameters[wanted] if wanted else next(iter(parameters.values()))
        values = effects.setdefault(name, {})
        if parameter.name in values:
            raise InputError(f"--effect gives {parameter.name} twice; keep one of the two")
        try:
            value = float(right)
        except ValueError:
            value = quantity_to_si(right.strip(), parameter.unit, f"--effect {text!r}: {parameter.name}")
        lower, upper = parameter.bounds
        if not (math.isfinite(value) and lower <= value <= upper):
            raise InputError(f"--effect {text!r}: {parameter.name} must lie between {lower:g} and {upper:g}")
        values[parameter.name] = value
    for name, values in effects.items():
        if missing := [p.name for p in catalogue[name].parameters if p.name not in values and p.name not in TRUTH]:
            lacks = missing[0]
            raise InputError(f"effect {name} has also the parameter {lacks}; add --effect {name}.{lacks}=VALUE")
    return effects


# --- A starter card for a new aircraft: what a record's columns seem to be, and what only its user can know.

NEEDED = ("time", *REQUIRED, "elevator")
ENGINE = ("n1_left", "n1_right", "engine_speed", "throttle", "throttle_left", "throttle_right")
ACCELERATIONS = ("ax", "az")
LATERAL = ("p", "r")
HELD = (*LATERAL, "density", "thrust")  # may be stated as constants
LEVEL = {"phi": "deg", "beta": "deg", "ay": "m/s^2"}  # the flight path's, zero where wings stay level; in this unit
STILL = np.deg2rad(0.5)  # rad/s of roll and yaw rate, in the mean square
KINEMATIC = ("theta", "phi", "beta", "ay", "altitude")
SUMS = {
    "thrust": 'thrust = ["thrust_left", "thrust_right"]',
    "elevator": "elevator = { elevator_left = 0.5, elevator_right = 0.5 } # the mean of both",
    "elevon": "elevator = { elevon_left = 0.5, elevon_right = 0.5 } # guess: the mean of the elevons",
    "aileron": "aileron = { aileron_right = 0.5, aileron_left = -0.5 } # guess: down is positive on either side",
}


class Todo(str):
    """A line of the card that its user completes: the key, and what it is."""

    key: str
    what: str

    def __new__(cls, key: str, entry: str, what: str) -> Todo:
        line = super().__new__(cls, f"{key} = {entry} {comment(what)}")
        line.key, line.what = key, what
        return line


@dataclass(frozen=True)
class Starter:
    """A starter card: its text, what is still to be filled in (key and what it is), and what it was made from."""

    text: str
    todo: list[tuple[str, str]]
    found: dict[str, Guess]
    unknown: list[RawColumn]

    @property
    def blind(self) -> tuple[str, ...]:
        """Accelerations that were not found: coefficients cannot be formed without them."""
        return tuple(n for n in ACCELERATIONS if n not in self.found or self.doubt(n))

    @property
    def facts(self) -> dict[str, Any]:
        channels = {
            name: {"place": g.column.place, **picked(g, "unit", "sign", "evidence"), "doubt": self.doubt(name) or None}
            for name, g in self.found.items()
        }
        unknown = [column.place for column in self.unknown]
        return {"channels": channels, "unknown": unknown, "todo": dict(self.todo), "not_found": list(self.blind)}

    def doubt(self, name: str) -> str:
        """Why a guess was not taken; empty where it was."""
        return _implausible(name, self.found[name])


def starter_card(path: Path) -> Starter:
    raw = read_raw(path)
    longest = max((len(c.values) for c in raw.columns if c.values is not None), default=0)
    if longest < MIN_SAMPLES:
        raise InputError(f"{path}: it has {longest} samples; at least {MIN_SAMPLES} are needed to guess from")
    guesses, unknown = guessed(raw.columns)
    lines = [
        f"# Starter card, written from {path.name}. Read every line: what says 'guess' may be wrong.",
        "# Fill in what says TODO, then: bayes-aero check RECORD --model THIS_FILE",
        "",
        f"title = {_text('the aircraft of ' + path.stem)}",
        'source = "starter card; state where the constants come from"',
        "",
        "[aircraft]",
        *(
            Todo(key, '"TODO"', f'{what}; write "... {AIRCRAFT_KEYS[key]}", or another unit of the kind')
            for key, what in MEANING.items()
        ),
        OPTIONAL,
        "",
        *channels_block(guesses, unknown, raw.columns),
        "",
        *sums_block(guesses),
        *constants_block(guesses),
        *sensors_block(guesses),
        *model_block(guesses, "mach" in guesses or "mach" in _derivable(guesses)),
    ]
    todo = [(line.key, line.what) for line in lines if isinstance(line, Todo)]
    return Starter("\n".join(lines) + "\n", todo, guesses, unknown)


def _text(words: str) -> str:
    return json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")


def channels_block(
    guesses: Mapping[str, Guess], unknown: Sequence[RawColumn], columns: Sequence[RawColumn]
) -> Iterator[str]:
    """Lines of `[channels]`: each guess with its evidence, what is needed and absent as TODO, the rest as comments."""
    yield "# The file's columns. sign = -1: the file counts the other way (nz up, elevator trailing edge up)."
    yield "[channels]"
    headless = all(column.label is None for column in columns)
    place = "column" if headless else "label"
    summed = "elevator" not in guesses and (_both(guesses, "elevator") or _both(guesses, "elevon"))
    for name in NEEDED:
        if name not in guesses and name not in HELD and not (name == "elevator" and summed):
            yield _absent(name, place)
    for name, guess in guesses.items():
        optional = "" if name in NEEDED or name in KINEMATIC else ", required = false"
        sign = ", sign = -1" if guess.sign < 0 else ""
        entry = f"{{ {_place(guess.column)}, unit = {_text(guess.unit or 'TODO')}{sign}{optional} }}"
        doubt, evidence = _implausible(name, guess), f"guess: {guess.evidence}; {_range(guess.values)}"
        if not doubt:
            yield Todo(name, entry, evidence) if not guess.unit else f"{name} = {entry} {comment(evidence)}"
            continue
        yield comment(f"NOT TAKEN, {doubt}; {guess.evidence}:")
        yield f"# {name} = {entry}"
        if name in NEEDED:
            yield _absent(name, place, "what the file has was not taken")
    if unknown:
        rest = [n for n in STANDARD_CHANNELS if n not in guesses]
        yield "# Columns that nothing was guessed for. Names that are still free:"
        for begin in range(0, len(rest), 10):
            yield f"# {', '.join(rest[begin : begin + 10])}"
    for column in unknown:
        if column.values is None:
            yield comment(f"{column.place}: no numbers")
            continue
        stated = column.unit or (split_heading(column.label)[1] if column.label else None) or "?"
        unit = _text(canonical(stated) or stated)
        yield f"# NAME = {{ {_place(column)}, unit = {unit}, required = false }} # {_range(column.values)}"
    if headless:
        yield "# The file has no header, so nothing can be guessed: say which column is what."


def _place(column: RawColumn) -> str:
    return f"column = {column.number}" if column.label is None else f"label = {_text(column.label)}"


def _range(values: np.ndarray) -> str:
    sound = values[np.isfinite(values)]
    return f"{sound.min():.5g} to {sound.max():.5g}" if len(sound) else "no finite number"


def _absent(name: str, place: str, why: str = "was not found in the file") -> str:
    standard = STANDARD_CHANNELS.get(name)
    what, unit = (standard.description, standard.unit) if standard else ("total net thrust", "N")
    if name in ACCELERATIONS:
        remark = f"{name} was not found: {what}. Without it diagnose works from trajectories alone, identify not:"
        return f'{comment(remark)}\n# {name} = {{ {place} = "...", unit = "{unit}" }}'
    return Todo(name, f'{{ {place} = "TODO", unit = "{unit}" }}', f"{what}; {why}")


def _implausible(name: str, guess: Guess) -> str:
    if name not in STANDARD_CHANNELS:
        return ""
    low, high = STANDARD_CHANNELS[name].plausible
    x = guess.si
    if x.min() >= low and x.max() <= high:
        return ""
    return f"{x.min():.4g} to {x.max():.4g} {STANDARD_CHANNELS[name].unit} is beyond any flight"


def _taken(guesses: Mapping[str, Guess]) -> set[str]:
    return {name for name, guess in guesses.items() if not _implausible(name, guess)}


def sums_block(guesses: Mapping[str, Guess]) -> Iterator[str]:
    """Lines of `[sums]`: what the left and the right one make together."""
    halves = [name for name in SUMS if _both(guesses, name) and not (name == "elevon" and "elevator" in guesses)]
    halves = [name for name in halves if not (name == "elevon" and "elevator" in halves)]
    if halves:
        yield from ("[sums]", *(SUMS[name] for name in halves), "")


def _both(guesses: Mapping[str, Guess], name: str) -> bool:
    """Whether the left and the right one were found and not what they make together."""
    return name not in guesses and {f"{name}_left", f"{name}_right"} <= _taken(guesses)


def _derivable(guesses: Mapping[str, Guess]) -> dict[str, str]:
    """Channels that are not in the file and can be formed from it, each by the best rule."""
    have = _taken(guesses)
    formed = {n: [rule for rule, needs in rules.items() if set(needs) <= have] for n, rules in RULES.items()}
    return {name: rules[0] for name, rules in formed.items() if rules and name not in have}


def constants_block(guesses: Mapping[str, Guess]) -> Iterator[str]:
    """Lines of `[derived]` and `[constants]`: channels that the file lacks, formed from others, or held."""
    derived = _derivable(guesses)
    absent = [name for name in RULES if name not in guesses and name not in derived]
    if not derived and absent:
        yield "# Where the altitude is recorded these can be formed from it (standard atmosphere):"
        yield "# [derived]"
        yield from (f'# {name} = "{ATMOSPHERE}"' for name in absent)
        yield ""
    if derived:
        yield "# Formed from other channels. The day's air is unlike a standard one by some per cent."
        yield "[derived]"
        for name, rule in derived.items():
            yield f'{name} = "{rule}" # guess; {"what the file has was not taken" if name in guesses else "not found"}'
        yield ""
    lines: list[str] = []
    engine = next((name for name in ENGINE if name in guesses), None)
    if engine and not any(name.startswith("thrust") for name in guesses):
        yield f"# Thrust may be read off a table over {engine} instead; see [tables.NAME] in the reference of the card."
    if "density" not in guesses and "density" not in derived:
        what = 'of the air, e.g. "0.9 kg/m^3"; neither it nor an altitude was found'
        lines.append(Todo("density", '"TODO"', what))
    if "thrust" not in guesses and not _taken(guesses) >= {"thrust_left", "thrust_right"}:
        sides = " and ".join(name for name in ("thrust_left", "thrust_right") if name in guesses)
        was = f"only {sides} was, or not taken" if sides else "was not found in the file"
        lines.append(Todo("thrust", '"TODO"', f'total net thrust, e.g. "2500 N"; {was}. Drag is as good as this'))
    zero = '"0 rad/s" # guess: found under no heading, taken as zero'
    lines += [f"{name} = {zero}" for name in LATERAL if name not in guesses]
    level = [name for name in LEVEL if name not in guesses]
    if level and "theta" in guesses and "altitude" in guesses:  # the flight path needs them
        if all(np.nanstd(guesses[name].si) < STILL for name in LATERAL if name in guesses):
            remark = "guess: found under no heading; it did not roll or yaw"
            lines += [f'{name} = "0 {LEVEL[name]}" # {remark}' for name in level]
        else:
            remark = "found under no heading, and it rolled or yawed. Sensors go unchecked."
            lines.append(f"# {', '.join(level)}: {remark}")
    if lines:
        yield from ("# Held constant over the record, for want of a channel.", "[constants]", *lines, "")


def sensors_block(guesses: Mapping[str, Guess]) -> Iterator[str]:
    """Lines of `[sensors]`: what is white in the record."""
    yield "# Standard deviations of the sensors' white noise; data sheets know better."
    yield "[sensors]"
    channels = FORMED_FROM[Axis.LATERAL] if has_lateral(guesses) else REQUIRED
    wanted = {n: g for n, g in guesses.items() if n in channels and not _implausible(n, g)}
    for name, guess in wanted.items() if "time" in guesses else ():
        deviation = noise_of(guess.si)
        if deviation > 0.5 * quantum(guess.si) and guess.unit is not None:  # less is rounding of a computed signal
            source = STANDARD_CHANNELS[name].unit if name in STANDARD_CHANNELS else "N"
            size = abs(float(from_si(deviation, guess.unit, name, source)))
            yield f'{name} = "{size:.2g} {guess.unit}" # guess: what is white in this record'
    yield ""


# --- The aircraft's constants: nothing of them can be read off a record.

MEANING = {
    "mass": "of the flight, with fuel and crew", "Ix": "moment of inertia about the roll axis",
    "Iy": "moment of inertia about the pitch axis", "Iz": "moment of inertia about the yaw axis",
    "Ixz": 'product of inertia; "0 kg m^2" if nobody knows it', "wing_area": "reference area of CL, CD and Cm",
    "chord": "mean aerodynamic chord", "span": "of the wing, from tip to tip",
    "tail_arm": "from the centre of gravity to the tailplane's quarter chord",
}  # fmt: skip
OPTIONAL = """\
# aspect_ratio = 7.0 # left out, it is span squared over wing area
# Positions from the centre of gravity, x forward, y right, z down; left out, they are zero.
# reference_point = ["0 m", "0 m", "0 m"] # that Cm is referred to, if it is not the centre of gravity
# accelerometer = ["0 m", "0 m", "0 m"] # where ax and az are measured
# engine = ["0 m", "0 m", "0 m"] # where the total thrust acts
# lateral_length = "10 m" # of rolling and yawing moment; left out, it is the span
# lateral_rate_length = "5 m" # l in p l/V and r l/V; left out, it is half the span: p b/2V
# engine_arm = "3 m" # of a left and a right engine from the plane of symmetry
# engine_inclination = "0 deg" # of the thrust line, nose up"""


# --- The section that names the model's effects, those of a stall where the record seems to hold one.

ATTACHED = (
    "attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = (
    "reattachment_hysteresis", "flow_separation", "separation_lag", "kirchhoff_lift", "separated_drag",
    "separated_moment", "separated_induced_drag",
)  # fmt: skip
LATERAL_EFFECTS = (
    "side_force_offset", "sideslip_side_force", "roll_offset", "sideslip_roll", "roll_damping", "yaw_rate_roll",
    "aileron_roll", "yaw_offset", "sideslip_yaw", "roll_rate_yaw", "yaw_damping", "rudder_yaw",
)  # fmt: skip
WINGS = ("roll_rate_incidence", "wing_asymmetry", "wing_lift_difference")
MEASURED = ("ay", "beta", "p", "r", "rudder")
REMARKS = {"separated_induced_drag": " # induced_share 0: drag of the attached lift, as published; 1: of the rest"}
MACH_MOVES, SOUND = 0.05, 330.0  # a change of Mach number that tells its effect, and m/s
ROLLS = np.deg2rad(1.0)  # rad/s of roll rate, in the mean square, that tell the lateral coefficients
STALLED = np.deg2rad(12.0)  # alpha beyond which the record is taken to hold a stall


def comment(words: str) -> str:
    return "# " + " ".join("".join(c if c.isprintable() else " " for c in words).split())


def has_lateral(guesses: Mapping[str, Guess]) -> bool:
    """Whether the channels of the lateral axis are there: six coefficients can be formed and explained."""
    return set(MEASURED) <= set(guesses) and ("aileron" in guesses or {"aileron_left", "aileron_right"} <= set(guesses))


def model_block(guesses: Mapping[str, Guess], mach: bool) -> Iterator[str]:
    """Lines of `[model]`: the demo aircraft's effects, as far as the record can tell them; `mach`: it is known."""
    reached = float(guesses["alpha"].si.max()) if "alpha" in guesses else 0.0
    lateral, stall = has_lateral(guesses), "" if reached > STALLED else "# "
    rolls = lateral and float(np.nanstd(guesses["p"].si)) > ROLLS
    mark = "" if rolls or not lateral else "# "
    yield "# bayes-aero effects lists all; diagnose looks for those that are missing."
    yield "[model]"
    if lateral:
        yield f"# guess: the aircraft {'rolls' if rolls else 'hardly rolls'} in this record:"
        yield f'{mark}axes = ["{Axis.LONGITUDINAL}", "{Axis.LATERAL}"]'
    yield "effects = ["
    yield f'  "{ATTACHED[0]}",'
    spread = {n: float(np.ptp(guesses[n].si)) for n in ("mach", "airspeed") if n in guesses}
    # Whether a lift slope over Mach number can be told from one over nothing.
    moves = mach and spread.get("mach", spread.get("airspeed", 0.0) / SOUND) > MACH_MOVES
    remark = "the Mach number hardly moves in this record" if mach else "needs the Mach number"
    yield '  "mach_lift",' if moves else f'#   "mach_lift", # {remark}'
    yield from (f'  "{name}",' for name in ATTACHED[1:])
    if "alpha" in guesses:
        holds = "no" if stall else "a"
        yield f"# guess: alpha reaches {np.rad2deg(reached):.3g} deg, so {holds} stall is in the record:"
    else:
        yield "# alpha was not found, so nobody knows whether a stall is in the record; if one is:"
    yield from (f'{stall}  "{name}",{REMARKS.get(name, "")}' for name in STALL)
    if lateral:
        yield "# Side force, rolling and yawing moment, with the axes above:"
        yield from (f'{mark}  "{name}",' for name in LATERAL_EFFECTS)
        yield from (f'{mark or stall}  "{name}",' for name in WINGS)
    yield "]"
    yield f"{stall}fixed = {{ tau1 = 0.0 }} # quasi-steady"


def put_starter_page(starter: Starter, record: Path, card: Path) -> tuple[Path, tuple[str, ...]]:
    """Write CARD.report.html; its path, and a sentence on what of it cannot be made."""
    from bayes_aero.report.page import put_page
    from bayes_aero.report.pages.check import card_page

    source = provenance(None, [], None, {})
    source["inputs"] = [{"name": record.stem, "source": record.name, "sha256": sha256_of(record)}]
    path = card.with_name(card.name + ".report.html")
    return path, put_page(lambda: card_page(starter, record.name, card.name, source), path.parent, path.name)
