"""Choices of options, written out so that --help need not import the numerical libraries; a test compares them."""

from enum import StrEnum


class NoiseModel(StrEnum):
    """Noise models of the posterior: `model.noise.Colour`."""

    WHITE = "white"
    AR1 = "ar1"
    BUFFET_AR1 = "buffet-ar1"


class Coefficients(StrEnum):
    """How coefficients are formed: `model.observations.Forming`."""

    MATCHED = "matched"
    PUBLISHED = "published"


class InitialState(StrEnum):
    """Where a manoeuvre begins: `jobs.options.INITIAL_STATES`."""

    FREE = "free"
    FIXED = "fixed"


class Inputs(StrEnum):
    """Inputs between samples: `jobs.options.INPUTS`."""

    LINEAR = "linear"
    HELD = "held"


class Split(StrEnum):
    """How data are held back to test the Gaussian process: `inference.splits.SplitKind`."""

    RANDOM = "random"
    BLOCK = "block"
    MANOEUVRE = "manoeuvre"


class SimulatedNoise(StrEnum):
    """Noise of a simulated record: `simulate.request.NOISES`."""

    NONE = "none"
    WHITE = "white"
    AR1 = "ar1"
    BUFFET = "buffet"


class Manoeuvre(StrEnum):
    """What is flown: `simulate.request.MANOEUVRES`."""

    RANDOM_STALL = "random_stall"
    SLOW_STALL = "slow_stall"
    ELEVATOR_DOUBLET = "elevator_doublet"
    ELEVATOR_3211 = "elevator_3211"
    MULTISINE = "multisine"
    THRUST_STEPS = "thrust_steps"
    SPEED_CHANGE = "speed_change"
    SIDESLIP = "sideslip"
    BANK_TO_BANK = "bank_to_bank"
    STABILIZER_STEPS = "stabilizer_steps"
    AILERON_DOUBLET = "aileron_doublet"
    RUDDER_DOUBLET = "rudder_doublet"
    STALL_WITH_BANK = "stall_with_bank"
    ENGINE_STEPS = "engine_steps"


class ExportForm(StrEnum):
    """Forms of an exported model: `jobs.handover.export.FORMS`."""

    JSBSIM = "jsbsim"
    FMU = "fmu"
    TABLES = "tables"
