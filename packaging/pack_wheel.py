"""Put compiled kernels into a pure wheel, which becomes a wheel of this platform and this Python beside it:

    python packaging/pack_wheel.py build/dist/lcp_catalog-VERSION-py3-none-any.whl

On x86-64 they are those of the levels v3 and v4, elsewhere those of this machine. Its metadata name the numba and llvmlite
for which they are compiled; with others they would not be used.
"""

from __future__ import annotations

import base64
import hashlib
import re
import sys
import sysconfig
import tempfile
import zipfile
from importlib.metadata import version
from pathlib import Path

import lcp_catalog as lcp
from lcp_catalog.kernels.cpu_level import LEVELS, level

_PINNED = ("numba", "llvmlite")


def compiled(folder: Path) -> dict[str, bytes]:
    """The files of the kernels, by their names in the wheel."""
    levels = ("x86-64-v3", "x86-64-v4") if level() in LEVELS else (None,)
    files = [path for one in levels for path in lcp.warm_up(one, folder)]
    place = "lcp_catalog/kernels/compiled"
    return {f"{place}/{path.parent.name}/{path.name}": path.read_bytes() for path in files}


def pack(pure: Path, kernels: dict[str, bytes], tag: str) -> Path:
    """Write the wheel of the platform."""
    with zipfile.ZipFile(pure) as wheel:
        files = {name: wheel.read(name) for name in wheel.namelist()} | kernels
    (folder,) = {name.split("/")[0] for name in files if name.endswith(".dist-info/RECORD")}
    facts = files[f"{folder}/WHEEL"].decode()
    facts = facts.replace("Root-Is-Purelib: true", "Root-Is-Purelib: false")
    files[f"{folder}/WHEEL"] = facts.replace("Tag: py3-none-any", f"Tag: {tag}").encode()
    metadata = files[f"{folder}/METADATA"].decode()
    metadata = re.sub(r"^Requires-Dist: numba\b.*\n", "", metadata, flags=re.M)
    pins = "".join(f"Requires-Dist: {name}=={version(name)}\n" for name in _PINNED)
    head, gap, text = metadata.partition("\n\n")
    files[f"{folder}/METADATA"] = f"{head}\n{pins.rstrip()}{gap}{text}".encode()
    del files[f"{folder}/RECORD"]
    rows = [f"{name},sha256={_digest(data)},{len(data)}" for name, data in files.items()]
    files[f"{folder}/RECORD"] = "\n".join([*rows, f"{folder}/RECORD,,", ""]).encode()
    packed = pure.with_name(pure.name.replace("py3-none-any", tag))
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as wheel:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name)  # of 1980: the same files give the same wheel
            entry.external_attr, entry.compress_type = 0o100644 << 16, zipfile.ZIP_DEFLATED
            wheel.writestr(entry, data)
    return packed


def _digest(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def main() -> None:
    """Pack the wheel that the command line names."""
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    platform = re.sub(r"[-.]", "_", sysconfig.get_platform())
    with tempfile.TemporaryDirectory() as folder:
        kernels = compiled(Path(folder))
    packed = pack(Path(sys.argv[1]), kernels, f"{python}-{python}-{platform}")
    print(f"{packed}: {len(kernels)} compiled kernels, {packed.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
