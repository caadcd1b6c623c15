"""`python -m bayes_aero` is `bayes-aero`."""

from bayes_aero.cli import main

main()
