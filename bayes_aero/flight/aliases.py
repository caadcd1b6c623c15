"""What people call channels and units in the headers of their files."""

from __future__ import annotations

import re

from bayes_aero.flight.channel import STANDARD_CHANNELS

__all__ = ["ALIASES", "UNITS", "plain_heading", "split_heading", "symbol_of"]

_NAMES: dict[str, str] = {
    "time": "t time utc sec seconds elapsed elapsedtime timestamp tsec gpstime reltime",
    "alpha": "alpha aoa angleofattack alfa alphacg alcg alphavane aoatrue alphatrue incidence al",
    "beta": "beta aos sideslip angleofsideslip sideslipangle betacg becg",
    "airspeed": "tas airspeedtrue tasairspeed v vtas trueairspeed vtrue airspeed vt vtascg ktas speed va",
    "calibrated_airspeed": "ias cas vcas vias kcas kias indicatedairspeed calibratedairspeed vc vi",
    "p": "p prate rollrate pb prgx omegax wx gyrox rollvel",
    "q": "q qrate pitchrate qb qrgy omegay wy gyroy pitchvel",
    "r": "r rrate yawrate rb rrgz omegaz wz gyroz yawvel",
    "phi": "phi roll bank rollangle bankangle rollattitude rollatt bankatt",
    "theta": "theta the pitch pitchangle pitchattitude pitchatt tht",
    "psi": "psi heading hdg yaw yawangle trueheading headingtrue",
    "ax": "ax nx nxb axcg accx accelx axb axbody longacc longitudinalacceleration acclong nxcg "
    "longloadfactor longitudinalloadfactor longaccel longitudinalaccel axialaccel",
    "ay": "ay ny nyb aycg accy accely ayb aybody latacc lateralacceleration acclat nycg "
    "latloadfactor lateralloadfactor lataccel lateralaccel",
    "az": "az nz nzb azcg accz accelz azb azbody normalacceleration loadfactor vertacc nzcg normacc accnorm "
    "normalaccel normaccel normalloadfactor normloadfactor vertloadfactor verticalloadfactor",
    "altitude": "alt altitude h hp pressurealtitude palt hbaro baroalt hqnh pressalt baroaltitude altmsl",
    "radio_altitude": "radalt ralt hradio radioaltitude radaralt",
    "elevator": "de deteu deted elevteu elevted elevator elev delv deltae elevatordeflection elevatorposition elevpos "
    "elevatorpos dele elevdefl",
    "stabilizer": "stab stabilizer stabiliser ih ihtrm pitchtrim stabtrim htrim stabpos",
    "rudder": "dr rudder rud drud rudderposition rudpos deltar rudderdeflection",
    "aileron_left": "daill aileronleft leftaileron ailleft aill dal",
    "aileron_right": "dailr aileronright rightaileron ailright ailr dar",
    "flap": "flap flaps flapposition flappos df flapangle",
    "spoiler_left": "dspll spoilerleft leftspoiler spll",
    "spoiler_right": "dsplr spoilerright rightspoiler splr",
    "n1_left": "n1l n1left n1eng1 n11 n1t1l",
    "n1_right": "n1r n1right n1eng2 n12 n1t2r",
    "thrust": "thrust fn netthrust totalthrust thrusttotal fntotal thr",
    "thrust_left": "thrustleft thrustl fnl leftthrust fnleft thrust1 fn1 thrl",
    "thrust_right": "thrustright thrustr fnr rightthrust fnright thrust2 fn2 thrr",
    "mach": "mach m machnumber ma machno",
    "density": "rho density airdensity",
    "static_temperature": "sat oat temperature statictemperature tstat outsideairtemperature ts",
    "static_pressure": "ps pstat staticpressure pstatic",
    "fuel_used": "fuelused fuelus fuelburn fuelburned",
    "latitude": "lat latitude",
    "longitude": "lon long longitude",
    "gear": "gear gearpos landinggear",
}

ALIASES: dict[str, str] = {alias: name for name, text in _NAMES.items() for alias in text.split()} | {
    name.replace("_", ""): name for name in STANDARD_CHANNELS
}
"""Channel by what a heading is called in lower case, without blanks, underscores and units."""

_UNIT_WORDS: dict[str, str] = {
    "deg": "deg degs degree degrees °",
    "rad": "rad rads radian radians",
    "deg/s": "deg/s dps degps degpersec deg/sec °/s degs-1 degsec",
    "rad/s": "rad/s radps radpersec rad/sec rads-1 radsec",
    "kt": "kt kts knot knots kn",
    "m/s": "m/s mps ms-1 m/sec",
    "km/h": "km/h kmh kph",
    "ft/s": "ft/s fps ft/sec",
    "m": "m meter meters metre metres",
    "ft": "ft feet foot",
    "g": "g gs gee",
    "m/s^2": "m/s^2 m/s2 m/s² mps2 ms2 ms-2 m/sec2 m/ss",
    "ft/s^2": "ft/s^2 ft/s2 fps2",
    "s": "s sec secs second seconds",
    "ms": "ms msec millisec milliseconds",
    "N": "n newton newtons",
    "kN": "kilonewton",
    "lbf": "lbf lb lbs pounds",
    "Pa": "pa",
    "hPa": "hpa mbar mb",
    "K": "k kelvin",
    "degC": "c degc °c celsius",
    "kg": "kg",
    "kg/m^3": "kg/m^3 kg/m3 kgm3 kg/m³",
    "%": "% pct percent",
    "1": "1 - none nd",
}
UNITS: dict[str, str] = {word: unit for unit, text in _UNIT_WORDS.items() for word in text.split()}
"""The unit, as cards spell it, by how headings spell it in lower case."""

_IN_NAME = {"ktas": "kt", "kcas": "kt", "kias": "kt", "nx": "g", "ny": "g", "nz": "g", "nzcg": "g", "loadfactor": "g"}
_BRACKETS = re.compile(r"^(.*?)\s*[\[({<]([^\])}>]*)[\])}>]\s*$")
_PARTS = re.compile(r"[\s_.:/#-]+")


_BESIDE = frozenset(
    "gyro vane sensor meas measured recorded raw filt filtered up down imu ahrs ins irs adc fdr eng probe boom".split()  # noqa: SIM905
)
"""Words that say where a channel comes from or which way it counts, not what it is: "Q gyro", "NZ up"."""


def plain_heading(heading: str) -> str:
    """The heading without such words, unless nothing would be left: "Q [deg/s]" of "Q gyro [deg/s]"."""
    bracketed = _BRACKETS.match(heading.strip())
    name, unit = (bracketed[1], heading.strip()[len(bracketed[1]) :]) if bracketed else (heading.strip(), "")
    kept = [word for word in _PARTS.split(name) if word and word.lower() not in _BESIDE]
    return (
        "_".join(kept) + unit if kept and any(k.lower() not in UNITS or k.lower() in ALIASES for k in kept) else heading
    )


def split_heading(heading: str) -> tuple[str, str | None]:
    """Name in lower case without blanks, and the unit where the heading tells it: "AoA [deg]", "alt_ft", "KTAS"."""
    bracketed = _BRACKETS.match(heading.strip())
    name, unit = (bracketed[1], UNITS.get(bracketed[2].strip().lower())) if bracketed else (heading.strip(), None)
    parts = [part for part in _PARTS.split(name.lower()) if part]
    if unit is None and not bracketed:
        for count in (2, 1):  # "rate_deg_s" before "accel_g"
            spelled = "/".join(parts[-count:])
            if len(parts) > count and spelled in UNITS:
                parts, unit = parts[:-count], UNITS[spelled]
                break
    key = re.sub(r"[^a-z0-9]", "", "".join(parts))
    return key, unit or _IN_NAME.get(key)


_SYMBOLS = frozenset(
    "nx ny nz ax ay az tas ktas ias kias cas kcas vtas aoa aos alpha beta theta phi psi mach rho".split()  # noqa: SIM905
)
_WANTED = frozenset("cmd command commanded target desired demand demanded ref reference selected sel set".split())  # noqa: SIM905


def symbol_of(heading: str) -> str | None:
    """The symbol that a heading ends with, "nx" of "Long. Load Factor nx [g]"; none of a value that was only wanted."""
    bracketed = _BRACKETS.match(heading.strip())
    words = [word for word in _PARTS.split((bracketed[1] if bracketed else heading).lower()) if word]
    while len(words) > 1 and words[-1] in UNITS and words[-1] not in _SYMBOLS:
        words.pop()
    return words[-1] if words and words[-1] in _SYMBOLS and not _WANTED & set(words) else None
