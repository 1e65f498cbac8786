"""Address of a live scene, and who may connect to it.

A scene is served to programs and pages of this machine: the address is a loopback one, a request for another host name is refused
(DNS rebinding: a foreign name that leads here), and so is a page of an unknown origin.
"""

import os
import socket
import urllib.parse
from collections.abc import Sequence
from typing import Final

from shuttle_marl.errors import printable
from shuttle_marl.scene import SceneError

HOST: Final = "127.0.0.1"
"""Scenes are served to this machine only."""
ORIGINS: Final = ("https://app.foxglove.dev", "https://studio.foxglove.dev", "file://")
"""Pages that may connect, beside those of this machine: Foxglove's, and those of desktop programs (Foxglove, Lichtblick)."""
_LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
_LONGEST_NAME: Final = 100


def bind(port: int) -> socket.socket:
    """Take a port, before any work is done; nothing is answered on it until a scene is served.

    Args:
        port: to take, 0 for a free one.

    Raises:
        SceneError: it is taken, or cannot be served on.
    """
    if not 0 <= port < 1 << 16:
        raise SceneError(f"port {port}: expected 0 (any free one) to 65535")
    listener = socket.socket()
    if os.name == "posix":  # connections that were just closed do not keep the port
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except OSError as error:
        listener.close()
        raise SceneError(f"port {port}: {error.strerror}; choose another with --port, or 0 for any free one") from error
    return listener


def refusal(hosts: Sequence[str], origins: Sequence[str], allowed: Sequence[str]) -> str | None:
    """Reason to refuse a connection, None if there is none.

    Args:
        hosts: the Host headers of its request.
        origins: the Origin headers, which every web page has to send and no other program does.
        allowed: origins of pages that may connect, beside those of this machine.
    """
    if len(hosts) != 1 or _name(f"//{hosts[0]}") not in _LOOPBACK:
        return (
            f"refused a connection to the host {printable(', '.join(hosts))[:_LONGEST_NAME] or 'of no name'}: expected localhost"
        )
    if len(origins) > 1:
        return "refused a connection with several origins"
    if origins and origins[0] not in allowed and not _is_local(origins[0]):
        origin = printable(origins[0])[:_LONGEST_NAME]
        return f"refused a page of {origin}: --origin {origin} would let it connect"
    return None


def _is_local(origin: str) -> bool:
    return origin.startswith(("http://", "https://")) and _name(origin) in _LOOPBACK


def _name(url: str) -> str | None:
    """The host name of a URL, None if it has none."""
    try:
        return urllib.parse.urlsplit(url).hostname
    except ValueError:
        return None
