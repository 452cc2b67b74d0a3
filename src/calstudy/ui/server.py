"""The server of the page: on this machine alone, and for those who know its token."""

from __future__ import annotations

import secrets
import socket
import webbrowser
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import SimpleCookie
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from fastapi import FastAPI
from nicegui import ui

from calstudy.errors import SetupError
from calstudy.study.run.project import Project
from calstudy.ui.page import serve_files, show

HOST = "127.0.0.1"
REFUSED = b"Not without the token: open the address that calstudy ui has printed.\n"
Scope = MutableMapping[str, Any]
App = Callable[[Scope, Any, Any], Awaitable[None]]


class Guard:
    """Lets nothing through without the token, neither pages nor files nor websockets.

    The token of the page's address becomes a cookie, which the browser sends with everything else. A
    websocket must come from a page of this server, too: a cookie knows no port.
    """

    def __init__(self, app: App, token: str, port: int) -> None:
        self.app, self.token, self.cookie = app, token, f"calstudy_{port}"

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        """Answer 403, set the cookie, or pass on."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        cookie = SimpleCookie(headers.get(b"cookie", "")).get(self.cookie)
        known = secrets.compare_digest((cookie.value if cookie else "").encode(), self.token.encode())
        if scope["type"] == "websocket":
            here = f"http://{headers.get(b'host', '')}"
            if known and headers.get(b"origin", here) == here:
                await self.app(scope, receive, send)
            else:
                await receive()
                await send({"type": "websocket.close", "code": 4403})
        elif given and secrets.compare_digest(given.encode(), self.token.encode()):
            here = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            to = [(b"location", b"/"), (b"set-cookie", here.encode()), (b"cache-control", b"no-store")]
            await _answer(send, 303, to)
        elif known and not given:
            await self.app(scope, receive, send)
        else:
            await _answer(send, 403, [(b"content-type", b"text/plain; charset=utf-8")], REFUSED)


async def _answer(send: Any, status: int, headers: list[tuple[bytes, bytes]], body: bytes = b"") -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def serve(project: Project, port: int, browser: bool) -> None:
    """Serve the page of a project until it is interrupted; prints its address. ``port`` 0 is a free one.

    SetupError: the port is in use.
    """
    listening = socket.socket()
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((HOST, port))
        listening.listen()
    except OSError as error:
        raise SetupError(f"port {port}: {error.strerror}; choose another with --port") from error
    port, token = listening.getsockname()[1], secrets.token_urlsafe(16)
    app = FastAPI(openapi_url=None)
    app.add_middleware(Guard, token=token, port=port)
    serve_files(app, project)
    ui.page("/")(lambda: show(project))
    title = f"calstudy: {project.file.stem}"
    ui.run_with(app, title=title, tailwind=False, show_welcome_message=False, favicon="⛰️")
    address = f"http://{HOST}:{port}/?token={token}"
    told = "Ctrl+C ends the page; a calibration goes on without it."
    print(f"calstudy ui: {project.file}", address, told, sep="\n", flush=True)
    if browser:
        webbrowser.open(address)
    settings = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=1)
    uvicorn.Server(settings).run(sockets=[listening])
