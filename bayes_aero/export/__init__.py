"""An identified aerodynamic model in the forms of other simulators."""
