"""A cable that can be cut: forwards TCP between a controller and a robot until told to hold or close."""

import socket
import threading
import time
from contextlib import suppress
from types import TracebackType
from typing import Self


class Cable:
    """Listens on a free port of loopback and forwards to an endpoint.

    Attributes:
        endpoint: where a controller connects instead.
    """

    def __init__(self, endpoint: str) -> None:
        host, _, port = endpoint.partition("/")[2].rpartition(":")
        self._target = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._flows = threading.Event()
        self._flows.set()
        self._sockets: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._flows.set()
        for end in (self._listener, *self._sockets):
            end.close()

    def cut(self, how: str) -> float:
        """Hold what is sent, as a pulled plug does, or close the connections; return when."""
        self._flows.clear()
        if how == "close":
            for end in self._sockets:
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
            self._sockets.clear()
        return time.monotonic()

    def mend(self) -> None:
        """Let everything flow again, what was held first."""
        self._flows.set()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
                far = socket.create_connection(self._target)
            except OSError:
                return
            self._sockets += [near, far]
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._forward, args=(source, sink), daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(65_536):
                self._flows.wait()
                sink.sendall(data)
        except OSError:
            pass
        finally:
            source.close()
            sink.close()
