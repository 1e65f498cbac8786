"""What goes wrong in an analysis and can be mended."""

from shuttle_marl.errors import ShuttleError


class AnalysisError(ShuttleError):
    """Nothing to analyse, or a picture that cannot be drawn."""
