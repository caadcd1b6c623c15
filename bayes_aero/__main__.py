"""`python -m bayes_aero` is `bayes-aero`."""

import sys

from bayes_aero.entry import main

sys.argv[0] = "bayes-aero"  # what provenance and help call it
main()
