"""Recordings for a viewer in a browser: files by name over HTTP, on loopback, nothing else."""

import os
import shutil
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote, unquote

from hexctl.record.viewer import LOCAL, check_recording


class FileServer:
    """Serves the files that it is told to; use as a context manager."""

    def __init__(self, origin: str) -> None:
        """Listen at a free port of loopback; pages of one origin, such as http://127.0.0.1:9090, may read."""
        self._files: dict[str, Path] = {}
        self._server = ThreadingHTTPServer((LOCAL, 0), self._handler(origin))
        self._thread = Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()

    def base(self, folder: str) -> str:
        """Return the URL below which the files of a folder are found."""
        return f"http://{LOCAL}:{self._server.server_port}/{quote(folder, safe='')}/"

    def add(self, folder: str, path: Path) -> str:
        """Serve a recording below a folder and return its URL.

        Raises InputError for a missing file or a file of another kind.
        """
        check_recording(path)
        self._files[f"/{folder}/{path.name}"] = path
        return self.base(folder) + quote(path.name)

    def _handler(self, origin: str) -> type[BaseHTTPRequestHandler]:
        files = self._files

        def server_port() -> int:
            return self._server.server_port

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self.headers.get("Host") != f"{LOCAL}:{server_port()}":
                    self.send_error(HTTPStatus.FORBIDDEN)  # a page of another name that leads here
                    return
                try:
                    file = files[unquote(self.path)].open("rb")
                except (KeyError, OSError):
                    self.send_error(HTTPStatus.NOT_FOUND)
                    return
                with file:
                    self.send_response(HTTPStatus.OK)
                    self.send_header("Content-Type", "application/octet-stream")
                    self.send_header("Content-Length", str(os.fstat(file.fileno()).st_size))
                    self.send_header("Access-Control-Allow-Origin", origin)
                    self.end_headers()
                    shutil.copyfileobj(file, self.wfile)

            def log_message(self, *_: Any) -> None:
                """Say nothing."""

        return Handler
