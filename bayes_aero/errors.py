"""The one exception that a user of the package is meant to read."""


class InputError(ValueError):
    """Bad input, told in one sentence: what is wrong, where (file, channel, sample) and how to mend it."""
