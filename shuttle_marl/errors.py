"""Base class of everything that users can fix, and the errors of a stroke that several packages raise."""


class ShuttleError(Exception):
    """An error whose message says what is wrong and what to do; command lines print it without a traceback."""


class OptionError(ShuttleError):
    """An option of an environment that it cannot take."""


class ActionError(ShuttleError):
    """An action that is not in the action space."""


class IllegalStrokeError(ActionError):
    """A stroke of the catalogue that is not legal in the state, or in the kernel a stroke in a rally that is over.

    Attributes:
        stroke: its catalogue index.
        row: row of a batch; None outside of batches.
    """

    def __init__(self, message: str, stroke: int, row: int | None = None) -> None:
        super().__init__(message)
        self.stroke, self.row = stroke, row
