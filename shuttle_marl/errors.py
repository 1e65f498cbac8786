"""The one base class of everything that users can mend."""


class ShuttleError(Exception):
    """An error whose message says what is wrong and what to do; command lines print it without a traceback."""
