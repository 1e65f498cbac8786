"""The server of the page: fixed files over HTTP, requests and replies over one websocket.

Whoever connects is taken for a stranger: the Host of a request must be this machine (DNS rebinding: a foreign name that leads
here), a page of another origin is refused, messages are small and few, and a client that does not read waits alone.
"""

import asyncio
import dataclasses
import ipaddress
import json
import logging
import os
import socket
import urllib.parse
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, Final

import anyio
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from shuttle_marl.errors import ShuttleError, printable
from shuttle_marl.staging import ATHLETES, model_file
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.telling import message

HOST: Final = "127.0.0.1"
LARGEST: Final = 1 << 18
"""Bytes of a message from a page: a played match is named with all strokes of the person."""
MOST_PAGES: Final = 200
"""Connections at a time."""
_RATE, _BURST = 40.0, 120.0
"""Requests a second of a connection, on average and at once."""
_TOGETHER: Final = 16
"""Requests of a connection that are answered at the same time."""
_THREADS: Final = 4
_SLOW: Final = frozenset(("analysis", "options", "styles"))
"""Requests that may have to wait for the game to be solved: they have threads of their own, and hold up no rally."""
_FAREWELL: Final = 1
"""Time that connections have to close when the server stops [s]."""
_LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self' data: blob:; media-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_TYPES: Final = {"index.html": "text/html", "watch.js": "text/javascript", "watch.css": "text/css"}

Answer = Callable[[Mapping[str, Any]], bytes]
"""Answers a request with the message that is sent back; raises ShuttleError. Called in a thread."""


def application(answer: Answer, page: Path, *, hosts: tuple[str, ...] = _LOOPBACK) -> ASGIApp:
    """The ASGI application.

    Args:
        answer: what requests of pages are answered with.
        page: folder of the built page.
        hosts: names by which this machine may be called; one that is ``*`` stands for every address in numbers.
    """
    routes: list[BaseRoute] = [Route("/", _file(page / "index.html"))]
    routes += [Route(f"/{name}", _file(page / name)) for name in _TYPES]
    routes += [Route(f"/{name}.glb", _file(model_file(name))) for name in ATHLETES]
    routes.append(WebSocketRoute("/ws", _Pages(answer).attend))
    return _Guard(Starlette(routes=routes), hosts)


def _file(path: Path) -> Callable[[Request], Awaitable[Response]]:
    kind = _TYPES.get(path.name, "model/gltf-binary")

    async def respond(_: Request) -> Response:
        return FileResponse(path, media_type=kind, headers={"Cache-Control": "no-cache"})

    return respond


class _Guard:
    """Refuses requests for other hosts and of foreign pages, before anything is done for them."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...]) -> None:
        self._app, self._hosts = app, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        reason = refusal(headers.getlist("host"), headers.getlist("origin"), self._hosts)
        if reason is None:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": reason[:100]})
        else:
            await PlainTextResponse(f"{reason}\n", status_code=403)(scope, receive, send)


def _with_headers(send: Send) -> Send:
    async def sending(event: Any) -> None:
        if event["type"] == "http.response.start":
            extra = {"content-security-policy": _POLICY, "x-content-type-options": "nosniff", "referrer-policy": "no-referrer"}
            event["headers"] = [*event["headers"], *((name.encode(), value.encode()) for name, value in extra.items())]
        await send(event)

    return sending


def refusal(hosts: list[str], origins: list[str], allowed: tuple[str, ...]) -> str | None:
    """Reason to refuse a request, None if there is none.

    Args:
        hosts: its Host headers.
        origins: its Origin headers; a web page sends one, and it must be the host itself.
        allowed: names of this machine; ``*`` stands for every address in numbers, which no foreign name can lead to.
    """
    host = _name(f"//{hosts[0]}") if len(hosts) == 1 else None
    if host is None or not (host in allowed or ("*" in allowed and _is_address(host))):
        name = printable(", ".join(hosts))[:100] or "of no name"
        return f"refused a request to the host {name}: open the address that was printed"
    if len(origins) > 1 or (origins and urllib.parse.urlsplit(origins[0]).netloc != hosts[0]):
        return f"refused a page of {printable(', '.join(origins))[:100]}: only the page of this server may connect"
    return None


def _name(url: str) -> str | None:
    try:
        return urllib.parse.urlsplit(url).hostname
    except ValueError:
        return None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class _Pages:
    """Everyone who is connected."""

    def __init__(self, answer: Answer) -> None:
        self._answer, self._count = answer, 0
        self._limiters: tuple[anyio.CapacityLimiter, anyio.CapacityLimiter] | None = None

    async def attend(self, socket: WebSocket) -> None:
        """Answer the requests of one page until it leaves."""
        await socket.accept()
        if self._count >= MOST_PAGES:
            await socket.close(1013, f"{MOST_PAGES} pages are open already")
            return
        self._limiters = self._limiters or (anyio.CapacityLimiter(_THREADS), anyio.CapacityLimiter(_THREADS))
        self._count += 1
        running: set[asyncio.Task[None]] = set()
        budget = _Budget(asyncio.get_running_loop().time())
        sending = asyncio.Lock()
        try:
            while True:
                text = await socket.receive_text()
                wait = budget.take(asyncio.get_running_loop().time())
                if wait > 0:
                    await asyncio.sleep(wait)
                if len(running) >= _TOGETHER:
                    await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
                task = asyncio.create_task(self._reply(socket, text, self._limiters, sending))
                running.add(task)
                task.add_done_callback(running.discard)
        except (WebSocketDisconnect, RuntimeError, KeyError):
            pass  # it has left, or sent bytes, which no page does
        finally:
            self._count -= 1
            for task in running:
                task.cancel()

    async def _reply(
        self, socket: WebSocket, text: str, limiters: tuple[anyio.CapacityLimiter, anyio.CapacityLimiter], sending: asyncio.Lock
    ) -> None:
        number: Any = None
        try:
            request = json.loads(text)
            if not isinstance(request, dict) or type(request.get("id")) is not int or not isinstance(request.get("op"), str):
                raise WatchError("a request is an object with a number `id` and a text `op`")
            number = request["id"]
            limiter = limiters[request["op"] in _SLOW]
            content = await anyio.to_thread.run_sync(self._answer, request, limiter=limiter)
        except ShuttleError as error:
            content = message({"id": number, "error": printable(str(error))})
        except (ValueError, RecursionError):
            content = message({"id": number, "error": "a request that is no JSON"})
        except Exception as error:  # a page is told of every failure, and the server serves the others
            logging.getLogger(__name__).exception("a request failed")
            content = message({"id": number, "error": f"the server failed ({type(error).__name__}); its console says more"})
        try:
            async with sending:
                await socket.send_bytes(content)
        except (WebSocketDisconnect, RuntimeError):
            pass


@dataclasses.dataclass
class _Budget:
    """Number of requests that a page may still send."""

    at: float
    left: float = _BURST

    def take(self, now: float) -> float:
        """Take one; returns how long the page has to wait for it [s]."""
        self.left = min(_BURST, self.left + (now - self.at) * _RATE) - 1
        self.at = now
        return max(0.0, -self.left / _RATE)


def bind(host: str, port: int) -> socket.socket:
    """Take a port, or a free one if that is taken.

    Args:
        host: address to listen on.
        port: 0 for any free one.

    Raises:
        WatchError: the host is no address of this machine.
    """
    if not 0 <= port < 1 << 16:
        raise WatchError(f"--port {port}: expected 0 (any free one) to 65535")
    try:
        family, _, _, _, _ = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise WatchError(f"--host {host}: {error.strerror}; give an address of this machine") from error
    for wanted in (port, 0):
        listener = socket.socket(family)
        if os.name == "posix":  # connections that were just closed do not keep the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, wanted))
            listener.listen(128)
        except OSError as error:
            listener.close()
            if wanted == 0:
                raise WatchError(f"--host {host}: {error.strerror}; give an address of this machine") from error
        else:
            return listener
    raise AssertionError("one of two ports is taken, or an error raised")


class Server(uvicorn.Server):
    """The server; :meth:`run` serves until an interrupt."""

    def __init__(self, app: ASGIApp) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                log_config=None,
                access_log=False,
                lifespan="off",
                ws="websockets-sansio",
                ws_max_size=LARGEST,
                ws_max_queue=8,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=_FAREWELL,
                server_header=False,
            )
        )


def hosts_of(host: str) -> tuple[str, ...]:
    """Names by which the server may be called, from the address that it listens on."""
    if host in _LOOPBACK:
        return _LOOPBACK
    return (*_LOOPBACK, host, socket.gethostname(), *(("*",) if host in ("0.0.0.0", "::") else ()))
