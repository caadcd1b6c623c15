"""The model for other simulators: an aircraft of JSBSim, and an FMU 2.0 for co-simulation."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from xml.etree.ElementTree import Comment, Element, indent, tostring

from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import DefectError, InputError
from bayes_aero.export.identified import Identified, Operand, Program, about, meaning, unit
from bayes_aero.physics.aircraft import GRAVITY, LATERAL, NAMES, Axis

# --- Programs as functions of JSBSim: one XML element an operation. Source: JSBSim reference manual, ch. Functions.

PREFIX = "bayes-aero"  # branch of the property tree for all that an export adds

SAME = {
    "add": "sum", "sub": "difference", "mul": "product", "div": "quotient", "pow": "pow", "sqrt": "sqrt", "exp": "exp",
    "log": "ln", "sin": "sin", "cos": "cos", "tan": "tan", "asin": "asin", "acos": "acos", "atan": "atan",
    "atan2": "atan2", "abs": "abs", "floor": "floor", "ceil": "ceil", "min": "min", "max": "max", "lt": "lt",
    "le": "le", "gt": "gt", "ge": "ge", "eq": "eq", "ne": "nq", "and": "and", "or": "or", "not": "not",
    "select": "ifthen",
}  # fmt: skip
LARGEST_EXPONENT = 700.0  # e to this is still a number


def element(tag: str, *content: Element | str, **attributes: str) -> Element:
    node = Element(tag, attributes)
    node.extend(x for x in content if not isinstance(x, str))
    node.text = "".join(x for x in content if isinstance(x, str)) or None
    return node


def value(x: float) -> Element:
    return element("value", repr(float(x)))


def read(name: str) -> Element:
    return element("property", name)


def call(tag: str, *arguments: Element | float | str) -> Element:
    """An operation of JSBSim; numbers, and properties by name."""
    given = (read(x) if isinstance(x, str) else value(x) if isinstance(x, float | int) else x for x in arguments)
    return element(tag, *given)


def function(name: str, content: Element) -> Element:
    return element("function", content, name=name)


def component(name: str, content: Element) -> Element:
    """A function of a system, which it evaluates in every frame."""
    return element("fcs_function", element("function", content), name=name)


def _reciprocal_of_one_and(x: Element) -> Element:
    return call("quotient", 1.0, call("sum", 1.0, x))


def _exp(x: Element, factor: float) -> Element:
    return call("exp", call("min", LARGEST_EXPONENT, call("product", factor, x)))


COMPOSED: dict[str, Callable[[Element], Element]] = {  # operations that JSBSim does not have, by those that it has
    "neg": lambda x: call("product", -1.0, x),
    "logistic": lambda x: _reciprocal_of_one_and(_exp(x, -1.0)),
    "tanh": lambda x: call("difference", call("product", 2.0, _reciprocal_of_one_and(_exp(x, -2.0))), 1.0),
    "sinh": lambda x: call("product", 0.5, call("difference", _exp(x, 1.0), _exp(deepcopy(x), -1.0))),
    "cosh": lambda x: call("product", 0.5, call("sum", _exp(x, 1.0), _exp(deepcopy(x), -1.0))),
    "expm1": lambda x: call("difference", call("exp", x), 1.0),
    "log1p": lambda x: call("ln", call("sum", 1.0, x)),
    "sign": lambda x: call("difference", call("gt", x, 0.0), call("lt", deepcopy(x), 0.0)),
    "cbrt": lambda x: call("product", COMPOSED["sign"](x), call("pow", call("abs", deepcopy(x)), 1.0 / 3.0)),
}


def functions(
    program: Program, inputs: Mapping[str, Element], outputs: Mapping[str, str], steps: str = "step"
) -> list[Element]:
    """The program as functions in their order: steps that are read more than once, then the outputs. `inputs`: how each
    input is read; `outputs`: their properties by name; `steps`: branch of the properties of steps."""
    nodes, uses, elements = dict(inputs), program.uses, []

    def node(x: Operand) -> Element:
        return deepcopy(nodes[x]) if isinstance(x, str) else value(x)

    for step in program.steps:
        composed = COMPOSED.get(step.operation) or partial(call, SAME[step.operation])
        content = composed(*(node(x) for x in step.arguments))
        if uses[step.name] > 1:
            name = f"{PREFIX}/{steps}/{step.name}"
            elements.append(function(name, content))
            content = read(name)
        nodes[step.name] = content
    for name, x in program.outputs.items():
        elements.append(function(outputs[name], node(x)))
    return elements


FOOT = 0.3048  # m
POUND = 4.4482216152605  # N
SLUG = POUND / FOOT  # kg
PROPERTIES: dict[str, tuple[str, float]] = {
    "alpha": ("aero/alpha-rad", 1.0), "beta": ("aero/beta-rad", 1.0), "airspeed": ("velocities/vt-fps", FOOT),
    "p": ("velocities/p-aero-rad_sec", 1.0), "q": ("velocities/q-aero-rad_sec", 1.0),
    "r": ("velocities/r-aero-rad_sec", 1.0), "mach": ("velocities/mach", 1.0), "altitude": ("position/h-sl-ft", FOOT),
    "density": ("atmosphere/rho-slugs_ft3", SLUG / FOOT**3), "alpha_dot": (f"{PREFIX}/state/alpha-dot-rad_sec", 1.0),
    "elevator": ("fcs/elevator-pos-rad", 1.0), "aileron": ("fcs/right-aileron-pos-rad", 1.0),
    "rudder": ("fcs/rudder-pos-rad", 1.0), "flap": ("fcs/flap-pos-deg", math.pi / 180.0),
}  # fmt: skip
"""Where JSBSim has a channel, and the factor to SI. Every other channel is a property `bayes-aero/input/NAME`."""
LEAST_SLOPE = 0.1  # of the equation of alpha-dot, by which its steps are divided; at zero the motion is not unique
SLOPE = f"{PREFIX}/state/lift-per-alpha-dot"
RATES_OF_SPEED = ("accelerations/udot-ft_sec2", "accelerations/wdot-ft_sec2")
FIRST_FRAMES = 1.5  # states take their static values before
NAME = r"[A-Za-z_][A-Za-z0-9_.-]*"
THRUST = f"{PREFIX}/input/thrust-N"


def aerodynamics_xml(identified: Identified) -> str:
    root = Element("aerodynamics")
    root.append(Comment("\n" + "\n".join(re.sub("-{2,}", "-", line) for line in about(identified)) + "\n"))
    program = identified.program.giving({name: x for name, x in identified.program.outputs.items() if name != "lag"})
    signals = program.inputs_of("signal")
    root.extend(function(f"{PREFIX}/state/{n}", _rest(read(_separated(n)))) for n in program.inputs_of("state"))
    for name in (n for n in signals if PROPERTIES.get(n, ("", 1.0))[1] != 1.0):
        property_name, factor = PROPERTIES[name]
        root.append(function(_signal(name), call("product", property_name, factor)))
    root.extend(functions(program, _inputs(identified, program), {name: _output(name) for name in program.outputs}))
    if "alpha_dot" in signals:
        slope = identified.lift_slope
        root.extend(functions(slope, _inputs(identified, slope), {"slope": SLOPE}, "slope"))
    for axis, content in _forces(identified).items():
        root.append(element("axis", function(f"{PREFIX}/total/{axis}", content), name=axis))
    return _text(root)


def system_xml(identified: Identified) -> str:
    """The system with parameters, inputs that JSBSim does not have, and the states, for the folder Systems."""
    program, channel = identified.program, element("channel", name="states")
    if "alpha_dot" in program.inputs_of("signal"):
        channel.extend(_alpha_dot(identified))
    if identified.lagged:
        [lag] = functions(program.giving({"lag": program.outputs["lag"]}), _inputs(identified, program), {"lag": "lag"})
        decay = call("exp", call("quotient", call("product", -1.0, "simulation/dt"), *list(lag)))
        channel.append(component(f"{PREFIX}/state/decay", decay))
        for point in identified.points:
            name, static = _separated(point), _rest(read(_output(f"{point}_static")))
            left = call("product", read(f"{PREFIX}/state/decay"), call("difference", read(name), static))
            channel.append(component(name, _first(static, call("sum", static, left))))
    start = {f"{PREFIX}/parameter/{name}": repr(identified.values[name]) for name in program.inputs_of("parameter")}
    inputs = (THRUST, *(_signal(n) for n in program.inputs_of("signal") if n not in PROPERTIES))
    start |= dict.fromkeys(inputs, "0.0")
    properties = (element("property", name, value=x) for name, x in start.items())
    return _text(element("system", *properties, channel, name=f"{identified.name}-states"))


def aircraft_xml(identified: Identified) -> str:
    """A body with the card's mass, inertia and thrust line; without a lateral model it is symmetric."""
    a = identified.actual_aircraft
    if Axis.LATERAL not in identified.model.axes:
        point, engine = ((x, 0.0, z) for x, _, z in (a.reference_point, a.engine))
        a = replace(a, reference_point=point, engine=engine, Ixy=0.0, Iyz=0.0)
    origin, incline = (0.0, 0.0, 0.0), a.engine_inclination
    sizes = {"wingarea": (a.wing_area, "M2"), "wingspan": (2.0 * a.half_span, "M"), "chord": (a.chord, "M")}
    places = {"AERORP": a.reference_point, "EYEPOINT": origin, "VRP": origin}
    # products of inertia in structural axes, of which x and z point the other way
    inertias = {"ixx": a.Ix, "iyy": a.Iy, "izz": a.Iz, "ixy": -a.Ixy, "ixz": a.Ixz, "iyz": -a.Iyz}
    masses = {name: (x / (SLUG * FOOT**2), "SLUG*FT2") for name, x in inertias.items()}  # JSBSim's has four digits
    masses["emptywt"] = (a.mass * GRAVITY / POUND, "LBS")
    metrics, balance = (
        [element(name, repr(float(x)), unit=unit) for name, (x, unit) in table.items()] for table in (sizes, masses)
    )
    metrics += [_location(place, name=name) for name, place in places.items()]
    balance.append(_location(origin, name="CG"))
    direction = element("direction", *_coordinates((math.cos(incline), 0.0, -math.sin(incline))))
    thrust = element("function", call("quotient", THRUST, POUND))
    parts = [
        element("fileheader", element("author", "bayes_aero"), element("description", identified.title)),
        element("metrics", *metrics),
        element("mass_balance", *balance, negated_crossproduct_inertia="false"),
        element("ground_reactions"),
        element(
            "external_reactions", element("force", thrust, _location(a.engine), direction, name="thrust", frame="BODY")
        ),
        element("system", file=f"{identified.name}-states"),
        element("aerodynamics", file=f"{identified.name}-aerodynamics.xml"),
    ]
    return _text(element("fdm_config", *parts, name=identified.name, version="2.0", release="ALPHA"))


def _inputs(identified: Identified, program: Program) -> dict[str, Element]:
    inputs = {f"parameter.{n}": read(f"{PREFIX}/parameter/{n}") for n in program.inputs_of("parameter")}
    inputs |= {f"aircraft.{n}": value(identified.inputs[f"aircraft.{n}"]) for n in program.inputs_of("aircraft")}
    inputs |= {f"state.{n}": read(f"{PREFIX}/state/{n}") for n in program.inputs_of("state")}
    for name in program.inputs_of("signal"):
        property_name, factor = PROPERTIES.get(name, (_signal(name), 1.0))
        inputs[f"signal.{name}"] = read(property_name if factor == 1.0 else _signal(name))
    return inputs


def _signal(name: str) -> str:
    """The property of a signal in SI that JSBSim does not have."""
    si = unit(name).replace("/", "_").replace("^", "")
    kind = "signal" if name in PROPERTIES else "input"
    return f"{PREFIX}/{kind}/{name.replace('_', '-')}" + (f"-{si}" if si not in ("", "1") else "")


def _output(name: str) -> str:
    return f"{PREFIX}/{'coefficient' if name in (*NAMES, *LATERAL) else 'separation'}/{name}"


def _forces(identified: Identified) -> dict[str, Element]:
    """Forces (lbf) and moments (lbf ft, about the reference point) by axis of the body."""
    a, has = identified.actual_aircraft, set(identified.exported.coefficients)
    area = a.wing_area / FOOT**2
    lift, drag, Cm, CY, Cl, Cn = (read(_output(name)) for name in (*NAMES, *LATERAL))
    sin, cos = (call(f, "aero/alpha-rad") for f in ("sin", "cos"))
    forward = call("difference", call("product", lift, sin), call("product", drag, cos))
    up = call("sum", call("product", lift, cos), call("product", drag, sin))
    axes = {
        "X": ("CL", forward, area), "Y": ("CY", CY, area), "Z": ("CL", call("product", -1.0, up), area),
        "ROLL": ("CY", Cl, area * a.moment_length / FOOT), "PITCH": ("CL", Cm, area * a.chord / FOOT),
        "YAW": ("CY", Cn, area * a.moment_length / FOOT),
    }  # fmt: skip
    return {n: call("product", "aero/qbar-psf", size, x) for n, (of, x, size) in axes.items() if of in has}


def _alpha_dot(identified: Identified) -> list[Element]:
    """Alpha-dot by a Newton step a frame, carried on to the present frame by its last change."""
    used = PROPERTIES["alpha_dot"][0]
    now, before, solved = (f"{used}-{part}" for part in ("now", "before", "solved"))
    # 1 + qbar S/(m V) dCL/d(alpha-dot): alpha-dot depends on itself through the lift; a Newton step divides by it
    area = identified.actual_aircraft.wing_area / FOOT**2
    inertia = call("max", call("product", "inertia/mass-slugs", "velocities/vt-fps"), 1.0)
    gain = call("quotient", call("product", "aero/qbar-psf", area, SLOPE), inertia)
    slope = call("max", LEAST_SLOPE, call("sum", 1.0, gain))
    step = call("quotient", call("difference", read(now), read(used)), slope)
    ahead = call("difference", call("product", 2.0, read(solved)), read(before))
    # alpha-dot of the frame before, from the accelerations of its forces
    u, w, u_dot, w_dot = (read(n) for n in ("velocities/u-aero-fps", "velocities/w-aero-fps", *RATES_OF_SPEED))
    size = call("sum", call("product", u, u), call("product", w, w))
    turning = call("difference", call("product", u, w_dot), call("product", w, u_dot))
    contents = {
        now: call("quotient", turning, call("max", size, 1.0)),
        before: _first(read(now), read(solved)),
        solved: _first(read(now), call("sum", read(used), step)),
        used: _first(read(now), ahead),
    }
    return [component(name, content) for name, content in contents.items()]


def _separated(point: str) -> str:
    """The state itself, 1 - X: JSBSim's states are zero before the first frame, and so the flow is attached there."""
    return f"{PREFIX}/state/{point}-separated"


def _rest(x: Element) -> Element:
    return call("difference", 1.0, x)


def _first(begin: Element, later: Element) -> Element:
    limit = call("product", FIRST_FRAMES, "simulation/dt")
    return call("ifthen", call("le", "simulation/sim-time-sec", limit), begin, later)


def _coordinates(place: Sequence[float]) -> list[Element]:
    return [element(name, repr(float(x))) for name, x in zip("xyz", place, strict=True)]


def _location(place: Sequence[float], **names: str) -> Element:
    """A position of the body from the centre of gravity, in structural axes."""
    x, y, z = place
    return element("location", *_coordinates((0.0 - x, y + 0.0, 0.0 - z)), unit="M", **names)


def _text(root: Element) -> str:
    indent(root)
    return '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n"


def jsbsim_files(identified: Identified) -> Mapping[str, str]:
    for name in (*identified.program.inputs_of("signal"), *identified.program.inputs_of("parameter")):
        if not re.fullmatch(NAME, name):
            raise InputError(f"{name} cannot be a property of JSBSim; give it another name")
    folder = f"aircraft/{identified.name}"
    return {
        f"{folder}/{identified.name}.xml": aircraft_xml(identified),
        f"{folder}/{identified.name}-aerodynamics.xml": aerodynamics_xml(identified),
        f"{folder}/Systems/{identified.name}-states.xml": system_xml(identified),
    }


# --- The model as an FMU 2.0 for co-simulation: its steps in the wrapper of pythonfmu.

MOST_SECONDS = 300
SLAVE = files("bayes_aero.export").joinpath("fmu_slave.txt").read_text("utf-8")
START = {"airspeed": 100.0, "density": 1.225}  # inputs that no flow has at zero


def write_fmu(identified: Identified, folder: Path) -> Path:
    """Build the FMU in `folder`. A step holds the inputs and solves the lag of the separation point exactly."""
    if find_spec("pythonfmu") is None:
        raise InputError('an FMU needs the package pythonfmu; install it with: pip install "bayes-aero[export]"')
    name = re.sub(r"\W", "_", f"{identified.name}_aerodynamics")
    name = name if name.isidentifier() else f"_{name}"
    with tempfile.TemporaryDirectory() as there:
        slave = Path(there) / f"{name}_slave.py"
        slave.write_text(slave_source(identified, name), encoding="utf-8")
        words = [sys.executable, "-m", "pythonfmu", "build", "-f", str(slave), "-d", there]
        # a process of its own: pythonfmu imports the slave by its name, and keeps that module
        done = subprocess.run(words, capture_output=True, text=True, timeout=MOST_SECONDS, check=False)
        made = Path(there) / f"{name}.fmu"
        if done.returncode or not made.is_file():
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise DefectError(f"pythonfmu did not build the FMU ({last})", "export --to jsbsim")
        return write_whole(made.read_bytes(), folder / made.name)


def slave_source(identified: Identified, name: str) -> str:
    program, read = identified.program, identified.program.inputs_of("parameter")
    signals, points = program.inputs_of("signal"), program.inputs_of("state")
    for channel in signals:
        if not channel.isidentifier():
            raise InputError(f"channel {channel} cannot be a variable of an FMU; give it another name on the card")
    outputs = {n: "separation point" for n in program.outputs if n != "lag"}
    outputs |= {n: f"{text} without lag" for n, text in outputs.items() if n.endswith("_static")}
    outputs |= dict.fromkeys(identified.exported.coefficients, "coefficient")
    return SLAVE.format(
        name=name,
        inputs={n: f"{meaning(n)}, {unit(n) or 'SI'}" for n in signals},
        points=points,
        outputs=outputs,
        parameters={p.name: identified.values[p.name] for p in identified.exported.parameters if p.name in read},
        constants={f"aircraft.{n}": identified.inputs[f"aircraft.{n}"] for n in program.inputs_of("aircraft")},
        steps=[(step.name, step.operation, step.arguments) for step in program.steps],
        results=dict(program.outputs),
        start={n: x for n, x in START.items() if n in signals},
        description=" ".join(about(identified)),
    )
