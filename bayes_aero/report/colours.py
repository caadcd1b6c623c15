"""The palette of figures and pages, with fixed roles."""

# Okabe and Ito's colours, and two of Paul Tol's: told apart with every common colour blindness.
COLOURS = {
    "measured": "#1a1a1a", "mle": "#0072B2", "gpr": "#D55E00", "crb": "#56B4E9", "crb_corrected": "#E69F00",
    "white": "#332288", "emcee": "#009E73", "nuts": "#CC79A7", "alone": "#1a1a1a", "scatter": "#D55E00",
    "prior": "#b0b0b0", "rising": "#882255", "falling": "#2a9d8f", "before": "#0072B2", "unconfirmed": "#d0d0d0",
    "after": "#D55E00", "chosen": "#D55E00", "candidate": "#9fb8c9",
}  # fmt: skip
