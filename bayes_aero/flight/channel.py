"""Channels: what a card says about a column of a file, and what the program knows of it by name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bayes_aero.units import canonical, from_si, si_unit, spellings


@dataclass(frozen=True)
class Channel:
    """Where a channel stands in a file, in which unit, and which way it counts there."""

    name: str  # inside the program, "alpha"; in SI there
    unit: str  # in the file, "deg"
    label: str | None = None  # in files with headers (.csv .mat .parquet .nc); without one, `name` is looked for
    column: int | None = None  # counted from 1, in files without a header (.asc)
    required: bool = True  # else a file may lack it, and the record then does
    sign: int = 1  # -1 where the file counts the other way: a load factor upward for az, an elevator trailing edge up

    @property
    def heading(self) -> str:
        """The name to look for in a file with headers."""
        return self.name if self.label is None else self.label

    @property
    def si(self) -> str:
        """The unit that it is held in: the program's, or the SI unit of the file's."""
        standard = STANDARD_CHANNELS.get(self.name)
        return standard.unit if standard else si_unit(self.unit, f"channel {self.name}")

    def filed(self, values: Any) -> np.ndarray:
        """SI values in the unit and with the sign of the file."""
        return np.asarray(self.sign * from_si(values, self.unit, self.name, self.si))


class StandardChannel(NamedTuple):
    """A channel that the program knows; `plausible` is what no sound record leaves: it catches wrong units."""

    name: str
    unit: str  # SI
    description: str
    plausible: tuple[float, float]


_TABLE = (
    # name, SI unit, description, plausible lo, hi
    ("time", "s", "time", -1e9, 1e10),
    ("ax", "m/s^2", "specific force at the accelerometer, body x (forward)", -200.0, 200.0),
    ("ay", "m/s^2", "specific force at the accelerometer, body y (right)", -200.0, 200.0),
    ("az", "m/s^2", "specific force at the accelerometer, body z (down); level flight -9.8", -200.0, 200.0),
    ("p", "rad/s", "roll rate", -10.0, 10.0),
    ("q", "rad/s", "pitch rate", -5.0, 5.0),
    ("r", "rad/s", "yaw rate", -5.0, 5.0),
    ("phi", "rad", "bank angle", -20.0, 20.0),  # unwrapped rolls are allowed
    ("theta", "rad", "pitch attitude", -1.6, 1.6),
    ("psi", "rad", "heading", -40.0, 40.0),  # unwrapped turns are allowed
    ("alpha", "rad", "angle of attack", -1.6, 1.6),
    ("beta", "rad", "sideslip", -1.6, 1.6),
    ("alpha_dot", "rad/s", "rate of angle of attack", -10.0, 10.0),
    ("beta_dot", "rad/s", "rate of sideslip", -10.0, 10.0),
    ("p_dot", "rad/s^2", "roll acceleration", -100.0, 100.0),
    ("q_dot", "rad/s^2", "pitch acceleration", -100.0, 100.0),
    ("r_dot", "rad/s^2", "yaw acceleration", -100.0, 100.0),
    ("airspeed", "m/s", "true airspeed", 0.0, 400.0),
    ("calibrated_airspeed", "m/s", "calibrated airspeed", -10.0, 400.0),
    ("mach", "1", "Mach number", -0.01, 3.0),
    ("altitude", "m", "pressure altitude", -1000.0, 40000.0),
    ("radio_altitude", "m", "radio altitude", -1000.0, 40000.0),
    ("elevator", "rad", "elevator deflection, trailing edge down positive", -1.6, 1.6),
    ("elevator_left", "rad", "left elevator deflection, trailing edge down positive", -1.6, 1.6),
    ("elevator_right", "rad", "right elevator deflection, trailing edge down positive", -1.6, 1.6),
    ("elevon_left", "rad", "left elevon deflection, trailing edge down positive", -1.6, 1.6),
    ("elevon_right", "rad", "right elevon deflection, trailing edge down positive", -1.6, 1.6),
    ("canard", "rad", "canard deflection, trailing edge down positive", -1.6, 1.6),
    ("stabilizer", "rad", "horizontal-tail trim angle", -1.6, 1.6),
    ("rudder", "rad", "rudder deflection", -1.6, 1.6),
    ("aileron", "rad", "aileron deflection, half of right less left, trailing edge down positive", -1.6, 1.6),
    ("aileron_left", "rad", "left aileron deflection", -1.6, 1.6),
    ("aileron_right", "rad", "right aileron deflection", -1.6, 1.6),
    ("flap", "rad", "flap deflection", -1.6, 1.6),
    ("spoiler_left", "rad", "left spoiler deflection", -1.6, 1.6),
    ("spoiler_right", "rad", "right spoiler deflection", -1.6, 1.6),
    ("dlc_left", "rad", "left direct-lift flap deflection", -1.6, 1.6),
    ("dlc_right", "rad", "right direct-lift flap deflection", -1.6, 1.6),
    ("n1_left", "1", "left engine speed, fraction", -0.1, 2.0),
    ("n1_right", "1", "right engine speed, fraction", -0.1, 2.0),
    ("engine_speed", "rad/s", "speed of the engine or propeller", -1.0, 2e4),
    ("throttle", "1", "throttle or power lever, fraction", -0.5, 2.0),
    ("throttle_left", "1", "left throttle, fraction", -0.5, 2.0),
    ("throttle_right", "1", "right throttle, fraction", -0.5, 2.0),
    ("thrust_left", "N", "left net thrust", -1e6, 1e6),
    ("thrust_right", "N", "right net thrust", -1e6, 1e6),
    ("thrust", "N", "total net thrust", -2e6, 2e6),
    ("fuel_used", "kg", "fuel used", -1e3, 3e5),
    ("static_temperature", "K", "static temperature", 150.0, 350.0),
    ("static_pressure", "Pa", "static pressure", 1200.0, 1.2e5),
    ("dynamic_pressure", "Pa", "dynamic pressure, half of density times true airspeed squared", -500.0, 1.5e5),
    ("density", "kg/m^3", "air density", 0.0, 2.0),
    ("latitude", "rad", "latitude", -1.6, 1.6),
    ("longitude", "rad", "longitude", -6.3, 6.3),
    ("gear", "1", "landing gear, 0 up", -1.0, 100.0),
)

STANDARD_CHANNELS = {name: StandardChannel(name, unit, text, (lo, hi)) for name, unit, text, lo, hi in _TABLE}

UNITS: dict[str, tuple[str, ...]] = {
    "rad": ("deg", "rad"), "rad/s": ("deg/s", "rad/s"), "rad/s^2": ("deg/s^2", "rad/s^2"), "m": ("ft", "m"),
    "m/s": ("kt", "km/h", "ft/s", "mph", "m/s"), "m/s^2": ("g", "ft/s^2", "m/s^2"), "K": ("degC", "K", "degF"),
    "Pa": ("hPa", "Pa", "kPa", "inHg", "psi", "lbf/ft^2"), "1": ("%", "1"), "N": ("lbf", "N", "kN"),
    "kg/m^3": ("g/m^3", "slug/ft^3", "kg/m^3", "lb/ft^3"), "kg": ("lb", "kg", "slug"), "m^2": ("ft^2", "m^2"),
    "s": ("s", "ms", "us", "ns", "min"),
}  # fmt: skip
"""Units that files have a quantity in, by its SI unit."""


def unit_choices(name: str) -> tuple[str, ...]:
    return UNITS.get(STANDARD_CHANNELS[name].unit, ()) if name in STANDARD_CHANNELS else ()


# --- What people call channels and units in the headers of their files.

_NAMES: dict[str, str] = {
    "time": "t time utc utctime sec seconds elapsed elapsedtime timestamp tsec gpstime reltime realtime "
    "missiontime simtime",
    "alpha": "alpha aoa angleofattack alfa alphacg alcg alphavane aoatrue alphatrue incidence al",
    "beta": "beta aos sideslip angleofsideslip sideslipangle betacg becg",
    "airspeed": "tas airspeedtrue tasairspeed v vtas trueairspeed vtrue airspeed vt vtascg ktas speed va",
    "calibrated_airspeed": "ias cas vcas vias kcas kias indicatedairspeed calibratedairspeed vc vi",
    "p": "p prate rollrate pb prgx omegax wx gyrox rollvel",
    "q": "q qrate pitchrate qb qrgy omegay wy gyroy pitchvel",
    "r": "r rrate yawrate rb rrgz omegaz wz gyroz yawvel",
    "phi": "phi roll bank rollangle bankangle rollattitude rollatt bankatt",
    "theta": "theta the pitch pitchangle pitchattitude pitchatt tht",
    "psi": "magneticheading magheading hdgmag psi heading hdg yaw yawangle trueheading headingtrue",
    "ax": "gloadaxial ax nx nxb axcg accx accelx axb axbody longacc longitudinalacceleration acclong nxcg "
    "longloadfactor longitudinalloadfactor longaccel longitudinalaccel axialaccel",
    "ay": "gloadside ay ny nyb aycg accy accely ayb aybody latacc lateralacceleration acclat nycg "
    "latloadfactor lateralloadfactor lataccel lateralaccel",
    "az": "gloadnorml gloadnormal "
    "az nz nzb azcg accz accelz azb azbody normalacceleration loadfactor vertacc nzcg normacc accnorm "
    "normalaccel normaccel normalloadfactor normloadfactor vertloadfactor verticalloadfactor",
    "altitude": "alt altitude h hp pressurealtitude palt hbaro baroalt hqnh pressalt baroaltitude altmsl",
    "radio_altitude": "radalt ralt hradio radioaltitude radaralt",
    "elevator": "de deteu deted elevteu elevted elevator elev delv deltae elevatordeflection elevatorposition elevpos "
    "elevatorpos dele elevdefl",
    "elevator_left": "elvl", "elevator_right": "elvr",
    "canard": "canard deltac canardposition canardpos canarddeflection",
    "stabilizer": "stab stabilizer stabiliser ih ihtrm pitchtrim stabtrim htrim stabpos",
    "rudder": "dr rudder rud drud rudderposition rudpos deltar rudderdeflection",
    "aileron": "ail aileron da dail deltaa aileronposition ailpos ailerondeflection dela",
    "aileron_left": "ailleft aill dal", "aileron_right": "ailright ailr dar",
    "flap": "flap flaps flapposition flappos df flapangle flapdeflection",
    "spoiler_left": "dspll spll", "spoiler_right": "dsplr splr",
    "n1_left": "n1l n1eng1 n11 n1t1l", "n1_right": "n1r n1eng2 n12 n1t2r",
    "thrust": "thrust fn netthrust totalthrust thrusttotal fntotal thr",
    "thrust_left": "fnl fnleft thrust1 fn1 thrl", "thrust_right": "fnr fnright thrust2 fn2 thrr",
    "throttle": "throttle throttleposition throttlepos",
    "throttle_left": "throttle1", "throttle_right": "throttle2",
    "engine_speed": "rpm enginerpm enginespeed proprpm propellerspeed",
    "dynamic_pressure": "qbar dynamicpressure dynpress dynpres dynpressure pdyn qdyn qinf dynp",
    "p_dot": "pdot rollaccel rollacceleration angularaccx",
    "q_dot": "qdot pitchaccel pitchacceleration angularaccy",
    "r_dot": "rdot yawaccel yawacceleration angularaccz",
    "alpha_dot": "alphadot aldot aoadot aoarate",
    "beta_dot": "betadot bedot aosdot sideslipdot",
    "mach": "mach m machnumber ma machno",
    "density": "rho density airdensity",
    "static_temperature": "sat oat temperature statictemperature tstat outsideairtemperature ts",
    "static_pressure": "ps pstat staticpressure pstatic",
    "fuel_used": "fuelused fuelus fuelburn fuelburned",
    "latitude": "lat latitude", "longitude": "lon long longitude",
    "gear": "gear gearpos landinggear",
}  # fmt: skip


# Names of the left and right half of what has two: "aileronr" and "raileron" are not the aileron. Only of whole words:
# "del" and "rde" are too short to say.
_SIDED = {
    alias: f"{whole}_{side}"
    for whole in (name.removesuffix("_left") for name in STANDARD_CHANNELS if name.endswith("_left"))
    for word in (whole, *_NAMES.get(whole, "").split())
    if len(word) > 3
    for side in ("left", "right")
    for mark in (side, side[0], f"{side[0]}h")
    for alias in (word + mark, mark + word)
}
ALIASES: dict[str, str] = (
    _SIDED
    | {alias: name for name, text in _NAMES.items() for alias in text.split()}
    | {name.replace("_", ""): name for name in STANDARD_CHANNELS}
)
"""Channel by what a heading is called in lower case, without blanks, underscores and units."""

_NO_UNIT_OF_A_NAME = frozenset(
    "1 - -- none nd ratio fraction frac mach min mins minute h hr hour rpm bar n1 n2 n3".split()  # noqa: SIM905
)
"""Words that end names for other reasons: "thrust_1", "alpha_min", "engine_N2"."""

_IN_NAME = {"ktas": "kt", "kcas": "kt", "kias": "kt", "nx": "g", "ny": "g", "nz": "g", "nzcg": "g", "loadfactor": "g"}
_IN_NAME |= dict.fromkeys(("rpm", "enginerpm", "proprpm"), "rpm")
_BRACKETS = re.compile(r"^(.*?)\s*[\[({<]([^\])}>]*)[\])}>]\s*$")
_BEHIND_COMMA = re.compile(r"([^,]*),_*([^,]+?)_*")  # "alpha,__deg"
_PARTS = re.compile(r"[\s_.:/#-]+")
_BESIDE = frozenset(
    "gyro vane sensor meas measured recorded raw filt filtered up down imu ahrs ins irs adc fdr eng probe boom".split()  # noqa: SIM905
)
"""Words that say where a channel comes from or which way it counts, not what it is: "Q gyro", "NZ up"."""
_SIDES = dict.fromkeys("l left lh lft port 1".split(), "left")  # noqa: SIM905
_SIDES |= dict.fromkeys("r right rh rgt stbd starboard 2".split(), "right")  # noqa: SIM905
_NUMBERED = re.compile(r"\b(eng|engine|motor|no|nr)([12])\b")
_AROUND = frozenset("eng engine motor no nr net total".split())  # noqa: SIM905
_SYMBOLS = frozenset(
    "nx ny nz ax ay az tas ktas ias kias cas kcas vtas aoa aos alpha beta theta phi psi mach rho".split()  # noqa: SIM905
)
_WANTED = frozenset("cmd command commanded target desired demand demanded ref reference selected sel set".split())  # noqa: SIM905


def _parted(heading: str) -> tuple[str, str]:
    """The name of a heading, and what stands in brackets behind it, with them."""
    bracketed = _BRACKETS.match(heading.strip())
    name = bracketed[1] if bracketed else heading.strip()
    return name, heading.strip()[len(name) :]


def plain_heading(heading: str) -> str:
    """The heading without such words, unless nothing would be left: "Q [deg/s]" of "Q gyro [deg/s]"."""
    name, unit = _parted(heading)
    kept = [word for word in _PARTS.split(name) if word and word.lower() not in _BESIDE]
    named = kept and any(not spellings(k) or k.lower() in ALIASES for k in kept)
    return "_".join(kept) + unit if named else heading


def side_of(heading: str) -> tuple[str, str] | None:
    """The heading without the word for one of two sides or engines, and "left" or "right": "net_thrust_1"."""
    name, unit = _parted(heading)
    words = _PARTS.split(_NUMBERED.sub(r"\1 \2", " ".join(filter(None, _PARTS.split(name.lower())))))
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = [word for word in words if word not in _SIDES and word not in _AROUND]
    return ("_".join(rest) + unit, sides[0]) if len(sides) == 1 and rest else None


def split_heading(heading: str, si: str | None = None) -> tuple[str, str | None]:
    """Name and unit of a heading: "AoA [deg]", "alt_ft", "KTAS"; `si` of the channel decides what "TAS [KN]" means."""
    bracketed = _BRACKETS.match(heading.strip()) or _BEHIND_COMMA.fullmatch(heading.strip())
    if bracketed and "," in bracketed[0][len(bracketed[1]) :] and _spelled(bracketed[2], si) is None:
        bracketed = None  # "Gload,norml" is a name of two words
    name, unit = (bracketed[1], _spelled(bracketed[2], si)) if bracketed else (heading.strip(), None)
    parts = [part for part in _PARTS.split(name.lower()) if part]
    if unit is None and not bracketed:
        for count in (2, 1):  # "rate_deg_s" before "accel_g"
            if len(parts) <= count or parts[-1] in _NO_UNIT_OF_A_NAME:
                continue
            last = parts[-count:]
            spelling = _spelled("/".join(last), si)  # "deg", "s2" is deg/s^2, "in", "hg" is inHg
            if spelling is None and count == 2 and last[1] in ("hg", "c", "f", "k"):
                spelling = _spelled(" ".join(last), si)
            if spelling is not None:
                parts, unit = parts[:-count], spelling
                break
    key = re.sub(r"[^a-z0-9]", "", "".join(parts))
    return key, unit or _IN_NAME.get(key)


def _spelled(text: str, si: str | None) -> str | None:
    """Only what the table of spellings knows: to pint, "(cal)" would be a calorie."""
    return canonical(text, si) if spellings(text) else None


def is_command(heading: str) -> bool:
    """Whether a heading names a command or a reference, not a measured position: "elevator_cmd"."""
    return bool(_WANTED & {word.lower() for word in _PARTS.split(heading)})


def symbol_of(heading: str) -> str | None:
    """The symbol that a heading ends with, "nx" of "Long. Load Factor nx [g]"; none of a value that was only wanted."""
    words = [word for word in _PARTS.split(_parted(heading)[0].lower()) if word]
    while len(words) > 1 and spellings(words[-1]) and words[-1] not in _SYMBOLS:
        words.pop()
    return words[-1] if words and words[-1] in _SYMBOLS and not is_command(heading) else None
