"""Sources that several effects have."""

DERIVATIVE = "a linear aerodynamic derivative; textbook form"
EVEN_TERM = "lowest even term of a Taylor series, by symmetry; our choice of form"
MACH_TERM = "first term of a Taylor series in Mach number; our choice of form"
RELATIVE_ERROR = "definition of a relative error"
STALL_MODEL = "Jategaonkar 2015, ch. 12, Kirchhoff stall model"
HFB_320 = "Jategaonkar 2015, longitudinal model of the HFB 320"
ATTAS = "the ATTAS stall model as published with the data of Jategaonkar 2015"
OUR_WIDTH = "our choice of width"  # of a prior
