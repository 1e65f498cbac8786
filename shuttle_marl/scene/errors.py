"""What can go wrong with scenes."""

from shuttle_marl.errors import ShuttleError


class SceneError(ShuttleError):
    """A scene that cannot be made, served or drawn, or an option that is none."""
