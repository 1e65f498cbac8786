"""What cannot be solved exactly."""

from shuttle_marl.errors import ShuttleError


class ExactError(ShuttleError):
    """Games that do not fit together, or values that have no error bound."""
