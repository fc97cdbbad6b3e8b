"""The root of every error that the user can mend. Its text is one clear sentence; commands print it and exit with 2."""


class UserError(ValueError):
    """Bad input or wrong use."""
