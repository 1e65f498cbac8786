"""The server of the page: static files over HTTP, requests and replies over a WebSocket.

Clients are untrusted. The Host header must name this machine (protection against DNS rebinding), pages of other origins are
refused, the size and rate of messages are limited, and a client that does not read delays only itself.
"""

import asyncio
import contextlib
import ipaddress
import logging
import mimetypes
import os
import shutil
import socket
import urllib.parse
from collections.abc import Awaitable, Callable, Iterator, Mapping
from ctypes.util import find_library
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import anyio
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.court import WatchError, messages
from shuttle_marl.court.staging import model_file
from shuttle_marl.court.staging.skeleton import ATHLETES
from shuttle_marl.reports.languages import LANGUAGES, Language, speaking

if TYPE_CHECKING:
    from playwright.sync_api import Page

HOST: Final = "127.0.0.1"
MAX_MESSAGE: Final = 1 << 18  # maximum size of a message from a page [bytes]: the plan of a match holds all strokes of the person
MAX_CONNECTIONS: Final = 200
_RATE, _BURST = 40.0, 120.0  # requests per second of a connection: sustained rate, and burst
_CONCURRENT: Final = 16  # maximum number of concurrent requests of a connection
_THREADS: Final = 4
# Requests that never wait for the game to be solved; the others have separate threads.
_FAST: Final = (messages.HelloRequest, messages.RallyRequest, messages.TagRequest, messages.FriendRequest)
_STALLED: Final = 30.0  # time for a page to read a reply [s]
_SHUTDOWN: Final = 1  # time for connections to close when the server stops [s]
_LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
CONTENT_POLICY: Final = (  # the page's own files alone, and no inline script
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self' data: blob:; media-src 'self' blob:; base-uri 'none'; form-action 'none'"
)
_SECURITY: Final = {
    "content-security-policy": f"{CONTENT_POLICY}; frame-ancestors 'none'",
    # Else a page of another origin could show the film that is tagged.
    "cross-origin-resource-policy": "same-origin",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}
_CURRENT: Final = {"Cache-Control": "no-cache"}
_TYPES: Final = {"watch.js": "text/javascript", "watch.css": "text/css"}

Answer = Callable[[messages.Request], bytes]  # encoded reply; raises ShuttleError; called in worker threads
Downloads = Mapping[tuple[str, str], Callable[[int], bytes]]  # a file about the match of a recorded rally


def application(
    answer: Answer,
    page: Path,
    *,
    downloads: Downloads | None = None,
    video: Path | None = None,
    language: Language = "en",
    hosts: tuple[str, ...] = _LOOPBACK,
    proxies: tuple[str, ...] = (),
) -> ASGIApp:
    """The ASGI application; ``video``: that which is tagged, ``language``: of a page whose reader has chosen none; ``hosts``:
    allowed values of the Host header (``*``: every IP address); ``proxies``: further ones, whose pages may connect whatever Host
    header the proxy sends."""

    async def index(_: Request) -> Response:
        content = in_language((page / "index.html").read_bytes(), language)
        return Response(content, media_type="text/html", headers=_CURRENT)

    routes: list[BaseRoute] = [Route("/", index), Route("/index.html", index)]
    routes += [Route(f"/{name}", _file(page / name)) for name in _TYPES]
    routes += [Route(f"/{name}.glb", _file(model_file(name))) for name in ATHLETES]
    if video is not None:
        routes.append(Route("/video", _file(video, mimetypes.guess_type(video.name)[0])))
    limiter = anyio.CapacityLimiter(1)  # one at a time: a report takes seconds of all cores
    routes += [Route(f"/{name}", _download(make, name, kind, limiter)) for (name, kind), make in (downloads or {}).items()]
    routes.append(WebSocketRoute("/ws", _Connections(answer).serve))
    return _guarded(Starlette(routes=routes), hosts, tuple(map(str.lower, proxies)))


def _file(path: Path, kind: str | None = None) -> Callable[[Request], Awaitable[Response]]:
    kind = kind or _TYPES.get(path.name, "model/gltf-binary")

    async def respond(_: Request) -> Response:
        return FileResponse(path, media_type=kind, headers=_CURRENT)

    return respond


def in_language(index: bytes, language: Language) -> bytes:
    """The file ``index.html`` for readers who have chosen no language."""
    return index.replace(b'<html lang="en">', f'<html lang="{language}">'.encode(), 1)


def _download(
    make: Callable[[int], bytes], name: str, kind: str, limiter: anyio.CapacityLimiter
) -> Callable[[Request], Awaitable[Response]]:
    async def respond(request: Request) -> Response:
        number = request.query_params.get("rally", "")
        if not number.isascii() or not number.isdecimal() or len(number) > 9:
            return PlainTextResponse(f"expected {name}?rally=NUMBER\n", status_code=400)
        wanted = request.query_params.get("language", "en")
        language = next((known for known in LANGUAGES if known == wanted), None)
        if language is None:
            return PlainTextResponse(f"expected language={'|'.join(LANGUAGES)}\n", status_code=400)
        try:
            with speaking(language):  # the thread has the context of this one
                content = await anyio.to_thread.run_sync(make, int(number) - 1, limiter=limiter)
        except ShuttleError as error:
            return PlainTextResponse(f"{printable(str(error))}\n", status_code=404)
        # A report contains its own policy, which allows its own scripts alone.
        return Response(content, media_type=kind, headers={"Content-Security-Policy": "frame-ancestors 'none'"})

    return respond


def _guarded(app: ASGIApp, hosts: tuple[str, ...], proxies: tuple[str, ...]) -> ASGIApp:
    """Refuses requests to other hosts and from other origins, and adds security headers to every response."""

    async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        reason = refusal(headers.getlist("host"), headers.getlist("origin"), hosts, proxies)
        if reason is None:
            await app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": reason[:100]})
        else:
            await PlainTextResponse(f"{reason}\n", status_code=403)(scope, receive, _with_headers(send))

    return guarded


def _with_headers(send: Send) -> Send:
    async def sending(event: Any) -> None:
        if event["type"] == "http.response.start":
            known = {name for name, _ in event["headers"]}
            added = [(name.encode(), value.encode()) for name, value in _SECURITY.items() if name.encode() not in known]
            event["headers"] = [*event["headers"], *added]
        await send(event)

    return sending


def refusal(hosts: list[str], origins: list[str], allowed: tuple[str, ...], proxies: tuple[str, ...] = ()) -> str | None:
    """Reason to refuse a request; None if it is allowed.

    ``origins``: its Origin headers (browsers send one), which must be the host itself, or a proxy; ``allowed``: allowed host
    names in lower case (``*``: every IP address, which DNS rebinding cannot forge); ``proxies``: further ones.
    """
    host = _split(f"//{hosts[0]}").hostname if len(hosts) == 1 else None
    if host is None or not (host in (*allowed, *proxies) or ("*" in allowed and _is_address(host))):
        name = printable(", ".join(hosts))[:100] or "of no name"
        return f"refused a request to the host {name}: open the address that was printed, or allow a name with --allowed-hosts"
    origin = _split(origins[0]) if len(origins) == 1 else None
    if origins and (origin is None or (origin.netloc.lower() != hosts[0].lower() and origin.hostname not in proxies)):
        return f"refused a page of {printable(', '.join(origins))[:100]}: only the page of this server may connect"
    return None


def _split(url: str) -> urllib.parse.SplitResult:
    try:
        return urllib.parse.urlsplit(url)
    except ValueError:
        return urllib.parse.urlsplit("")


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class _Connections:
    def __init__(self, answer: Answer) -> None:
        self._answer, self._count = answer, 0
        self._limiters = anyio.CapacityLimiter(_THREADS), anyio.CapacityLimiter(_THREADS)

    async def serve(self, socket: WebSocket) -> None:
        """Answer the requests of one connection until it closes."""
        await socket.accept()
        if self._count >= MAX_CONNECTIONS:
            await socket.close(1013, f"{MAX_CONNECTIONS} pages are open already")
            return
        self._count += 1
        messages.SHOWN.set([])
        running: set[asyncio.Task[None]] = set()
        clock = asyncio.get_running_loop().time
        tokens, at = _BURST, clock()  # a token bucket
        sending = asyncio.Lock()
        try:
            while True:
                text = await socket.receive_text()
                now = clock()
                tokens, at = min(_BURST, tokens + (now - at) * _RATE) - 1, now
                if tokens < 0:
                    await asyncio.sleep(-tokens / _RATE)
                if len(running) >= _CONCURRENT:
                    await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
                task = asyncio.create_task(self._reply(socket, text, sending))
                running.add(task)
                task.add_done_callback(running.discard)
        except (WebSocketDisconnect, RuntimeError, KeyError):
            pass  # the connection is closed, or sent bytes, which pages never do
        finally:
            self._count -= 1
            for task in running:
                task.cancel()

    async def _reply(self, socket: WebSocket, text: str, sending: asyncio.Lock) -> None:
        number = messages.request_id(text)
        try:
            request = messages.decode_request(text)
            limiter = self._limiters[not isinstance(request, _FAST)]
            content = await anyio.to_thread.run_sync(self._answer, request, limiter=limiter)
        except ShuttleError as error:
            content = messages.encode_reply(number, printable(str(error)))
        except Exception as error:  # pages receive every error, and the server continues
            logging.getLogger(__name__).exception("a request failed")
            content = messages.encode_reply(number, f"the server failed ({type(error).__name__}); see its console")
        try:
            async with sending:
                await asyncio.wait_for(socket.send_bytes(content), _STALLED)
        except TimeoutError:  # the page does not read
            with contextlib.suppress(WebSocketDisconnect, RuntimeError, TimeoutError):
                await asyncio.wait_for(socket.close(1008, "the page does not read"), _SHUTDOWN)
        except (WebSocketDisconnect, RuntimeError):
            pass


def bind(host: str, port: int) -> socket.socket:
    """Bind a socket to a port, or to a free port if that one is in use or 0. Raises WatchError: the host is not an address of
    this machine."""
    if not 0 <= port < 1 << 16:
        raise WatchError(f"--port {port}: expected 0 (any free one) to 65535")
    try:
        family, _, _, _, _ = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise WatchError(f"--host {host}: {error.strerror}; give an address of this machine") from error
    while True:
        listener = socket.socket(family)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # recently closed connections do not block the port
        try:
            listener.bind((host, port))
            listener.listen(128)
        except OSError as error:
            listener.close()
            if port == 0:
                raise WatchError(f"--host {host}: {error.strerror}; give an address of this machine") from error
            port = 0
        else:
            return listener


class Server(uvicorn.Server):
    """The HTTP and WebSocket server; :meth:`run` serves until it is interrupted."""

    def __init__(self, app: ASGIApp) -> None:
        # uvicorn prints a traceback for each frame of invalid UTF-8.
        logging.getLogger("uvicorn.error").addFilter(_is_no_bad_text)
        super().__init__(
            uvicorn.Config(
                app,
                log_config=None,
                access_log=False,
                lifespan="off",
                ws="websockets-sansio",
                ws_max_size=MAX_MESSAGE,
                ws_max_queue=8,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=_SHUTDOWN,
                server_header=False,
            )
        )


def _is_no_bad_text(record: logging.LogRecord) -> bool:
    return not record.getMessage().startswith("Invalid UTF-8")


def hosts_of(host: str) -> tuple[str, ...]:
    """Allowed values of the Host header for an address to listen on."""
    if host in _LOOPBACK:
        return _LOOPBACK
    # Browsers send names in lower case, whatever a machine is called.
    return (*_LOOPBACK, host.lower(), socket.gethostname().lower(), *(("*",) if host in ("0.0.0.0", "::") else ()))


_SIZE: Final = (1280, 720)
_BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge")
_FLAGS: Final = (
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--ignore-gpu-blocklist",
    "--use-gl=angle",
)


def browser_program() -> str:
    """Path of Chromium or a related browser; ``$CHROMIUM`` takes precedence. Raises WatchError: none is installed."""
    for name in (os.environ.get("CHROMIUM", ""), *_BROWSERS):
        if name and (found := shutil.which(name)):
            return found
    raise WatchError("this needs Chromium or Chrome; install it, or name it in the variable CHROMIUM")


@contextlib.contextmanager
def browser_page(size: tuple[int, int] = _SIZE, *flags: str, **options: Any) -> "Iterator[Page]":
    """A page of a headless browser, which is closed at the end; ``options`` of the page, and further ``flags`` of the browser.
    Raises WatchError: no browser is installed."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415  an extra

    program = browser_program()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=[*browser_flags(), *flags])
        yield browser.new_page(viewport={"width": size[0], "height": size[1]}, **options)
        browser.close()


def browser_flags() -> list[str]:
    """Flags of a headless browser that makes no network requests of its own. Without a GPU, Mesa is two to three times as fast as
    SwiftShader."""
    mesa = find_library("EGL") is not None and any(Path("/usr/lib").glob("*/dri/swrast_dri.so"))
    # Chromium does not start as root with its sandbox.
    root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    return [*root, *_FLAGS, f"--use-angle={'gl-egl' if mesa else 'swiftshader'}"]
