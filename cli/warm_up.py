"""``lcp warm-up``: kernels compiled before they are needed."""

from __future__ import annotations

import click

from . import options
from .files import FileCommand
from .messages import log_format_option, say


def compile_missing(command: str) -> None:
    """Compile the kernels of a command that are not compiled, before its work begins."""
    from lcp_catalog.production.warm_up import compile_kernels, missing

    from .progress import progress

    if found := missing(command):
        say(f"compiling kernels for this machine, the first time only: {len(found)}")
        with progress("kernels", [entry.seconds for entry in found]) as update:
            compile_kernels(found, update)


@click.command("warm-up", cls=FileCommand, example="lcp warm-up --level x86-64-v3 -o kernels")
@click.option(
    "--level",
    type=click.Choice(["x86-64-v3", "x86-64-v4"]),
    help="Compile for processors with AVX2 (v3) or AVX-512 (v4). Default: this machine's level.",
)
@options.output_option("DIR", required=False)
@log_format_option
def command(level: str | None, output: str | None) -> None:
    """Compile the kernels of the commands, so that no first use waits for it: about a minute on two cores.

    Kernels are kept in the user's cache folder. -o copies them into a folder for containers or a cluster, where the
    environment variable LCP_KERNELS names it. Files that are there stay, also those of other levels.
    """
    from lcp_catalog.kernels.entries import entries
    from lcp_catalog.production.warm_up import warm_up

    from .progress import progress

    with progress("kernels", [entry.seconds for entry in entries()]) as update:
        files = warm_up(level, output, update)
    say(f"{files[0].parent}: {len(files)} kernels", "done", kernels=len(files))
