"""The ``lcp`` command: finds commands without importing them, and turns errors into one line and an exit code.

Commands are imported only when they are run, so that ``lcp --help`` stays quick.
"""

from __future__ import annotations

import importlib
import sys

import click

from lcp_catalog._version import __version__

COMMANDS = {
    # name: (module, one line for the overview)
    "dem": ("dem", "Look at DEM products."),
    "render": ("render", "Render an area under one Sun and one view."),
    "sun": ("sun", "Say where the Sun stands over a place."),
    "build-catalog": ("build_catalog", "Build a catalogue of control points."),
    "inspect": ("inspect", "Say what is in a catalogue, and whether it is intact."),
    "report": ("report", "Draw a catalogue as one self-contained page."),
    "validate": ("validate", "Find a catalogue's points in images, and compare them with renders."),
    "fit-reflectance": ("fit_reflectance", "Fit a reflectance model to goniometer measurements."),
    "simulate": ("simulate", "Take a frame with a camera that never flew."),
    "trade": ("trade", "Measure what each accuracy tier costs and changes."),
}


class LazyGroup(click.Group):
    """A group that knows its commands by name and imports a command's module when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"{__package__}.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="lcp")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.option("-v", "--verbose", count=True, help="Say more on stderr; twice for debugging.")
def cli(debug: bool, verbose: int) -> None:
    """Catalogues of lunar control points: made from DEMs, proved by rendering."""
    if verbose:
        import logging

        level = logging.DEBUG if verbose > 1 else logging.INFO
        logging.basicConfig(
            level=level, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr
        )


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 failed, 2 wrong usage, 3 and 4 as the command says, 130 interrupted."""
    arguments = sys.argv[1:] if argv is None else argv
    sys.exit(run(arguments))


def run(arguments: list[str]) -> int:
    """Run the command line; the exit code is returned. One line on stderr says what went wrong."""
    from .failures import exit_code_of  # nothing heavy: errors only

    try:
        result = cli.main(args=arguments, prog_name="lcp", standalone_mode=False)
    except click.exceptions.Exit as exit_:
        return exit_.exit_code
    except BaseException as error:
        if "--debug" in arguments and not isinstance(error, click.ClickException | click.Abort):
            raise
        return exit_code_of(error)
    return result if isinstance(result, int) else 0
