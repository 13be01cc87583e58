"""A server of one folder on the loopback that gives parts of files, as servers of cloud-optimised files do."""

from __future__ import annotations

import contextlib
import hashlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any


@dataclass
class Served:
    """The server's URL, and what it was asked: method, path and number of bytes given."""

    url: str
    asked: list[tuple[str, str, int]] = field(default_factory=list)


@contextlib.contextmanager
def range_server(folder: Path, tags: bool = True) -> Iterator[Served]:
    """Serve a folder. ``tags``: with ETags (digests of the content); False: without any mark of the content."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            self._answer(True)

        def do_HEAD(self) -> None:
            self._answer(False)

        def _answer(self, with_body: bool) -> None:
            path = folder / self.path.lstrip("/")
            if not path.is_file():
                self.send_error(404)
                return
            content, wanted = path.read_bytes(), self.headers.get("Range")
            start, end, size = 0, len(content), len(content)
            if wanted:
                first, _, last = wanted.removeprefix("bytes=").partition("-")
                start, end = int(first), min(int(last or size - 1) + 1, size)
            part = content[start:end]
            self.send_response(206 if wanted else 200)
            self.send_header("Accept-Ranges", "bytes")
            self.send_header("Content-Length", str(len(part)))
            if wanted:
                self.send_header("Content-Range", f"bytes {start}-{end - 1}/{size}")
            if tags:
                self.send_header("ETag", f'"{hashlib.md5(content).hexdigest()}"')
            self.end_headers()
            served.asked.append((self.command, self.path, len(part) * with_body))
            if with_body:
                self.wfile.write(part)

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    served = Served(f"http://127.0.0.1:{server.server_port}")
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
