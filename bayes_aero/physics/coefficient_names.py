"""The coefficients' names, and the channels that they are formed from (see `coefficients`)."""

NAMES = ("CL", "CD", "Cm")
REQUIRED = ("ax", "az", "p", "q", "r", "alpha", "airspeed", "density", "thrust")
