"""The ``lcp`` command: the list of subcommands, and the exit code of a run.

A subcommand's module is imported only when it runs, so that ``lcp --help`` is quick.
"""

from __future__ import annotations

import gc
import importlib
import logging
import os
import sys
from typing import Any

import click

from lcp_catalog._version import __version__

from .messages import log_format_option, reset, show_log
from .signals import Stopped, stopping_signals

COMMANDS = {
    # name: (module, one line for the overview)
    "sample": ("sample", "Write the sample data of the tutorial into a folder."),
    "dem": ("dem", "Describe, check or map DEM products."),
    "sun": ("sun", "Compute the Sun's azimuth and elevation at a place."),
    "camera": ("camera", "Show what a camera sees; make camera files from SPICE kernels."),
    "render": ("render", "Render a terrain image for one Sun direction and one view."),
    "build-catalog": ("build_catalog", "Build a catalogue of control points."),
    "trade": ("trade", "Measure what every approximation costs and changes."),
    "merge": ("merge", "Join catalogues of neighbouring regions or of several cell sizes."),
    "inspect": ("inspect", "Summarise a catalogue and check that it is intact."),
    "report": ("report", "Write a catalogue report as one self-contained HTML page."),
    "diff": ("diff", "Compare two catalogues point by point."),
    "export": ("export", "Write a catalogue's points in the formats of other programs."),
    "flight-source": ("flight_source", "Write the C reference of the flight file (.lcpf)."),
    "query": ("query", "List the points that a camera can use, and the expected position."),
    "windows": ("windows", "List when a site has enough usable points."),
    "validate": (
        "validate",
        "Find a catalogue's points in images and compare the images with renders.",
    ),
    "simulate": ("simulate", "Simulate a camera image with detector noise and blur."),
    "fit-reflectance": ("fit_reflectance", "Fit a reflectance model to goniometer measurements."),
    "warm-up": ("warm_up", "Compile the kernels before they are needed, here or for others."),
    "help": ("help", "Print a how-to page, or the help of a command."),
}


class LazyGroup(click.Group):
    """Command group that imports a command's module on first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"{__package__}.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Takes -v and --debug after the command, too."""
        end = args.index("--") if "--" in args else len(args)
        moved = [one for one in args[:end] if one in ("-v", "-vv", "--verbose", "--debug")]
        rest = [one for one in args[:end] if one not in moved]
        return super().parse_args(ctx, [*moved, *rest, *args[end:]])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in COMMANDS and not ctx.resilient_parsing:
            from difflib import get_close_matches

            begun = [name for name in COMMANDS if name.startswith(f"{args[0]}-")]
            for alike in get_close_matches(args[0][:80], COMMANDS, 1) or begun:
                raise click.UsageError(f"No such command {args[0]!r}. Did you mean {alike!r}?", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


AFTER_COMMANDS = """
\b
Exit codes:
  0  done
  1  failed: one line says what, which file, and what to do
  2  wrong usage
  3  a catalogue was written, but some areas failed (build-catalog --keep-going)
  4  the answer is no (validate, inspect, diff, dem check, camera info, report --require)
  130, 143, 129  stopped by Ctrl-C, SIGTERM, SIGHUP

\b
Completion of commands and options by the Tab key, for bash (zsh, fish alike):
  eval "$(_LCP_COMPLETE=bash_source lcp)"     in ~/.bashrc

\b
A first catalogue:
  lcp sample hadley                           the sample data with a Makefile
  make -C hadley                              catalogue, report, validation
"""


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=AFTER_COMMANDS,
)
@click.version_option(__version__, prog_name="lcp")
@click.option("--debug", is_flag=True, help="Show the traceback if an error occurs.")
@click.option("-v", "--verbose", count=True, help="Say on stderr what is done; -vv: in detail.")
@log_format_option
def cli(debug: bool, verbose: int) -> None:
    """Build and use catalogues of lunar control points, made from DEMs and tested on renders."""
    if verbose:
        show_log(logging.DEBUG if verbose > 1 else logging.INFO)


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit.

    Exit codes: 0 success, 1 failure, 2 wrong usage, 3 and 4 as the command's help states,
    130 interrupted, 143 and 129 stopped by SIGTERM and SIGHUP.
    """
    _open_standard_streams()
    # matrices are small, and workers many; a process of one thread has its file checked without a fresh interpreter
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # idle threads take no processor time
    gc.set_threshold(100_000, 20, 20)  # imports make many objects and hardly any garbage
    sys.unraisablehook, sys.excepthook = _log_unraisable, _show_raised
    code = run(sys.argv[1:] if argv is None else argv)
    gc.freeze()  # else the interpreter looks through all objects of the imports before it ends
    sys.exit(code)


def _open_standard_streams() -> None:
    """Open the null device in place of closed standard streams: else the next file that is opened takes
    their number, and what libraries print goes into it.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115  open to the end
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115  open to the end


def _log_unraisable(found: Any) -> None:
    """Log an error that cannot be raised, like that of rasterio's log for a message that is not UTF-8; the
    call in which it happened has an error of its own. Of a signal nothing is said: it is sent again.
    """
    logging.getLogger(__name__).debug("ignored in %r: %r", found.object, found.exc_value)


def _show_raised(kind: type[BaseException], error: BaseException, where: Any) -> None:
    """Print a traceback (`--debug`), but not of the error above, which was never raised in Python, and not of a signal, which
    C code prints before the interpreter comes to the function above.
    """
    if issubclass(kind, Stopped):
        for name in ("last_value", "last_traceback", "last_exc"):  # else it counts as on its way
            setattr(sys, name, None)
    elif where is not None:
        sys.__excepthook__(kind, error, where)


def run(arguments: list[str]) -> int:
    """Run the command line and return the exit code. An error prints one line on stderr."""
    from .failures import exit_code_of  # a light import: error classes only

    try:
        reset()
        with stopping_signals():
            result = cli.main(args=arguments, prog_name="lcp", standalone_mode=False)
    except click.exceptions.Exit as exit_:
        return exit_.exit_code
    except BaseException as error:
        if "--debug" in arguments and not isinstance(
            error, click.ClickException | click.Abort | KeyboardInterrupt
        ):
            raise
        return exit_code_of(error)
    return result if isinstance(result, int) else 0
