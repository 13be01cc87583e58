"""Help of a command: its options in groups by what they are about, and an example."""

from __future__ import annotations

import click

from .names import long_name

GROUPS = {
    heading: flags.split()
    for heading, flags in {
        "Area": "--center --lon --lat --height --at --size --bounds --around --gsd --surface --level",
        "Cell sizes": "--levels --altitudes --ifov",
        "Sun and light": (
            "--sun-azimuth --sun-elevation --sun-azimuths --sun-elevations --time --range --subsolar --sun "
            "--earthshine --bounce --environment --environment-azimuth --environment-sources --sun-sky-ratio"
        ),
        "Camera and view": (
            "--camera --trajectory --for-trajectory --oem --aem --mounting --kernels --observer --instrument "
            "--start --stop --line-time --summing --ik --body-frame --report --fov --field-of-view --altitude "
            "--look --image-size --view --off-nadir --view-azimuth --frame --shadow-catcher --background "
            "--background-white"
        ),
        "Catalogue": "--catalog",
        "DEM": "--dem --product-order --dem-sigma --dem-resolution",
        "Brightness and accuracy": "--reflectance --albedo --albedo-encoding --albedo-reference --accuracy --tolerance",
        "Points": (
            "--spacing --located-probability --per-view --footprint --max-points --max-bytes --search --passes "
            "--noise --max --min-points --image-scale"
        ),
        "What is known before": "--position-sigma --attitude-sigma --height-sigma --map-sigma --pixel-sigma --known-pose",
        "Windows": "--window --step --remove-offset",
        "Image": (
            "--encoding --band --nodata --faint --blur --shot-share --exposure --bits --seed --samples"
        ),
        "Fit": "--c --refractive-index --polarisation --normalize --name",
        "Run": (
            "--config --jobs --memory --scheduler --part --list-parts --select --merge --resume --keep-going "
            "--try-cures --areas --rounds --budget --max-error --time-limit"
        ),
        "Output": (
            "--output --preview --map --plot --chart --fit-errors --dossier --evidence --require --located "
            "--list --set --quick --plan --explain --json --depfile --overwrite --log-format --help"
        ),
    }.items()
}
"""Flags of all commands by what they are about; a flag has one place in every command."""


def grouped(command: click.Command, context: click.Context) -> dict[str, list[click.Option]]:
    """Options of a command by heading, in the order of `GROUPS`. KeyError for a flag that is not there."""
    place = {
        flag: (heading, k) for heading, flags in GROUPS.items() for k, flag in enumerate(flags)
    }
    found: dict[str, list[click.Option]] = {heading: [] for heading in GROUPS}
    for one in command.get_params(context):
        if isinstance(one, click.Option) and not one.hidden:
            found[place[long_name(one)][0]].append(one)
    for members in found.values():
        members.sort(key=lambda one: place[long_name(one)][1])
    return {heading: members for heading, members in found.items() if members}


def write_options(
    command: click.Command, context: click.Context, formatter: click.HelpFormatter
) -> None:
    """Write the options of a command under their headings."""
    for heading, members in grouped(command, context).items():
        records = [record for one in members if (record := one.get_help_record(context))]
        with formatter.section(heading):
            formatter.write_dl(records)


def write_example(example: str, formatter: click.HelpFormatter) -> None:
    """Write the example of a command as it is typed."""
    with formatter.section("Example"):
        for line in example.splitlines():
            formatter.write(f"{'':{formatter.current_indent}}{line}\n")
