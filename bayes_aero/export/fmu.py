"""The model as an FMU 2.0 for co-simulation: the Python function in the wrapper of pythonfmu."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import DefectError, InputError
from bayes_aero.export.identified import Identified, about, meaning, python_source, unit

MOST_SECONDS = 300
SLAVE = '''"""Co-simulation of an identified aerodynamic model."""

import math
from xml.etree.ElementTree import SubElement

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

import {module} as model

INPUTS = {inputs!r}
POINTS = {points!r}
OUTPUTS = {outputs!r}


class {name}(Fmi2Slave):
    author = "bayes_aero"
    description = {description!r}

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.inputs = dict.fromkeys(INPUTS, 0.0) | {start!r}
        self.parameters = dict(model.PARAMETERS)
        self.states = dict.fromkeys(POINTS, 1.0)
        self.outputs = dict.fromkeys(OUTPUTS, 0.0)
        for name, text in INPUTS.items():
            self._add(name, self.inputs, name, text, causality=Fmi2Causality.input)
        for name in self.parameters:
            kind = {{"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}}
            self._add(f"parameter.{{name}}", self.parameters, name, "", **kind)
        for name, text in OUTPUTS.items():
            self._add(name, self.outputs, name, text, causality=Fmi2Causality.output)
        for name in POINTS:
            self._add(name, self.states, name, "separation point", causality=Fmi2Causality.output)

    def _add(self, name, values, key, text, **kind):
        def put(x):
            values[key] = x

        variable = Real(name, getter=lambda: values[key], setter=put, description=text, **kind)
        self.register_variable(variable, nested=False)

    def to_xml(self, *given):
        root = super().to_xml(*given)
        node = SubElement(root.find("ModelStructure"), "InitialUnknowns")
        for number, variable in enumerate(self.vars.values(), 1):
            if variable.causality is Fmi2Causality.output:
                SubElement(node, "Unknown", index=str(number))
        return root

    def _evaluate(self):
        found = model.aerodynamics(**self.inputs, **self.states, parameters=self.parameters)
        self.outputs.update((name, found[name]) for name in OUTPUTS)
        return found

    def exit_initialization_mode(self):
        found = self._evaluate()
        for name in POINTS:
            self.states[name] = found[name + "_static"]
        self._evaluate()

    def do_step(self, current_time, step_size):
        found = self._evaluate()
        for name in POINTS:
            static = found[name + "_static"]
            self.states[name] = static + (self.states[name] - static) * math.exp(-step_size / found["lag"])
        self._evaluate()
        return True
'''
START = {"airspeed": 100.0, "density": 1.225}  # inputs that no flow has at zero


def write_fmu(found: Identified, folder: Path) -> Path:
    """Build the FMU in `folder`. Inputs are the channels that the model reads, outputs its coefficients and separation
    points, parameters its own. A step holds the inputs and solves the lag of the separation point exactly."""
    if find_spec("pythonfmu") is None:
        raise InputError('an FMU needs the package pythonfmu; install it with: pip install "bayes-aero[export]"')
    name = re.sub(r"\W", "_", f"{found.name}_aerodynamics")
    name = name if name.isidentifier() else f"_{name}"
    with tempfile.TemporaryDirectory() as there:
        function, slave = Path(there) / f"{name}_function.py", Path(there) / f"{name}_slave.py"
        function.write_text(python_source(found), encoding="utf-8")
        slave.write_text(slave_source(found, name, function.stem), encoding="utf-8")
        words = [sys.executable, "-m", "pythonfmu", "build", "-f", str(slave), "-d", there, str(function)]
        # a process of its own: pythonfmu imports the slave by its name, and keeps that module
        done = subprocess.run(words, capture_output=True, text=True, timeout=MOST_SECONDS, check=False)
        made = Path(there) / f"{name}.fmu"
        if done.returncode or not made.is_file():
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise DefectError(f"pythonfmu did not build the FMU ({last})", "export --to jsbsim")
        return write_whole(made.read_bytes(), folder / made.name)


def slave_source(found: Identified, name: str, module: str) -> str:
    """The text of the FMU's Python class, which evaluates the function of `module`."""
    program = found.program
    signals, points = program.inputs_of("signal"), program.inputs_of("state")
    outputs = {n: "separation point" for n in program.outputs if n != "lag"}
    outputs |= {n: f"{text} without lag" for n, text in outputs.items() if n.endswith("_static")}
    outputs |= dict.fromkeys(found.exported.coefficients, "coefficient")
    return SLAVE.format(
        module=module,
        name=name,
        inputs={n: f"{meaning(n)}, {unit(n) or 'SI'}" for n in signals},
        points=points,
        outputs=outputs,
        start={n: x for n, x in START.items() if n in signals},
        description=" ".join(about(found)),
    )
