"""Files that a user names on a server or in an archive: ``https://``, ``http://``, ``/vsicurl/``, ``s3://``, ``/vsis3/``
(buckets that anyone may read) and ``/vsizip/``.

A path joins slashes, so that ``https://a/b.tif`` becomes ``https:/a/b.tif``; the functions here take both. What a server's file
is, its size and its ETag (else the time of its last change) say: it is never read whole.
"""

from __future__ import annotations

import functools
import os
import re
from pathlib import Path

from .errors import DemError

_URL = re.compile(r"(?:/vsicurl/)?(https?):/+([^/].*)")
_BUCKET = re.compile(r"(?:s3:/+|/vsis3/)([^/]+)/(.+)")
_ZIP = "/vsizip/"
_ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL")
_PATIENCE_S = 30.0


def url_of(path: Path | str) -> str | None:
    """The URL of a file on a server; None for any other file. Buckets are those of Amazon, or of the server
    that ``AWS_ENDPOINT_URL`` names.
    """
    text = os.fspath(path)
    if found := _URL.fullmatch(text):
        return f"{found[1]}://{found[2]}"
    if found := _BUCKET.fullmatch(text):
        server = next((os.environ[name] for name in _ENDPOINTS if os.environ.get(name)), None)
        if server is not None:
            return f"{server.rstrip('/')}/{found[1]}/{found[2]}"
        return f"https://{found[1]}.s3.amazonaws.com/{found[2]}"
    return None


def archive_of(path: Path | str) -> Path | None:
    """The archive that a file lies in; None for any other file."""
    text = os.fspath(path)
    if not text.startswith(_ZIP):
        return None
    inner = text.removeprefix(_ZIP)
    if inner.lstrip("/").startswith("vsi"):  # an archive in an archive
        return None
    if inner.startswith("{"):
        return Path(inner[1:].partition("}")[0])
    for name in (inner, f"/{inner}"):  # the path has joined the slashes of /vsizip//a/b.zip
        for place in reversed(Path(name).parents):
            if place.is_file():
                return place
    return Path(inner)


def gdal_name(path: Path | str) -> str:
    """The name by which GDAL opens a file."""
    text, url, archive = os.fspath(path), url_of(path), archive_of(path)
    if url is not None:
        return f"/vsicurl/{url}"
    if archive is None or text.startswith(f"{_ZIP}{{"):
        return text
    return f"{_ZIP}{{{archive}}}/{text.partition(str(archive))[2].lstrip('/')}"


def beside(folder: Path, name: str) -> str:
    """A name of a file relative to a folder; names on a server or in an archive stay."""
    stays = url_of(name) is not None or name.startswith(_ZIP)
    return name if stays else str(folder / name)


def absolute(path: Path | str) -> str:
    """An absolute name of the same file."""
    return os.fspath(path) if url_of(path) or archive_of(path) else os.path.abspath(path)


def server_state(url: str) -> tuple[int, str]:
    """Size and ETag (else the time of the last change) of a file on a server, which is asked. DemError, which names the
    URL, if the server does not answer or does not say them.
    """
    if "?" in url or "@" in url:
        raise DemError(
            f"{url.partition('?')[0]}: a URL with a key or a password would be kept in results; name a public file, or "
            "download it"
        )
    import urllib.error  # noqa: PLC0415  # 20 ms: only where a server is asked
    import urllib.request  # noqa: PLC0415  # 20 ms: only where a server is asked
    from http.client import HTTPException  # noqa: PLC0415  # 20 ms: only where a server is asked

    request = urllib.request.Request(url, method="HEAD", headers={"Accept-Encoding": "identity"})
    try:
        with urllib.request.urlopen(request, timeout=_PATIENCE_S) as answer:
            headers = answer.headers
    except urllib.error.HTTPError as error:
        raise DemError(f"{url}: the server answers {error.code} {error.reason}") from error
    except (OSError, HTTPException, ValueError) as error:
        reason = getattr(error, "reason", error)
        raise DemError(f"{url}: the server does not answer ({reason})") from error
    tag = headers.get("ETag") or headers.get("Last-Modified")
    size = headers.get("Content-Length", "")
    if not tag or not size.isdecimal():
        raise DemError(
            f"{url}: the server states no size, or neither an ETag nor a time of change, so that another content would "
            "not be noticed; download the file"
        )
    if headers.get("Accept-Ranges", "bytes").lower() != "bytes":
        raise DemError(f"{url}: the server gives no parts of files; download the file")
    return int(size), tag


@functools.lru_cache(maxsize=256)
def first_state(url: str) -> tuple[int, str]:
    """`server_state` when this process first asked."""
    return server_state(url)
