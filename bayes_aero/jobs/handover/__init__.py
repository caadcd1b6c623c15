"""The identified model of a finished result, handed to other simulators."""
