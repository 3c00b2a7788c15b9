"""``ddic new``: write a case file to start from."""

from pathlib import Path

import click

from ddic.cli.failures import failures_as_lines, warnings_as_lines
from ddic.errors import InputError


@click.command()
@click.argument("reference", metavar="REFERENCE", type=click.Path(path_type=Path))
@click.argument("deformed", metavar="DEFORMED...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), default=Path("case.toml"),
              metavar="CASE.toml", help="Case file to write.")
def new(reference: Path, deformed: tuple[Path, ...], output: Path) -> None:
    """Write a commented case file for a pair of images, or for a series of several deformed ones.

    Region and size of the elements come from the pattern that the reference image bears.
    """
    # Imported here because they bring OpenCV, which --help does not need.
    from ddic.check.pattern import choose_region, find_pattern
    from ddic.check.starter import write_starter_case
    from ddic.io.image_file import open_image
    from ddic.io.replace_on_exit import replaced_on_exit

    with failures_as_lines(output), warnings_as_lines():
        _require_new(output)
        image = open_image(reference)
        for path in deformed:
            other = open_image(path)
            if (other.width, other.height) != (image.width, image.height):
                raise InputError(f"{path}: the image is {other.width}x{other.height} px, but the reference {reference} "
                                 f"is {image.width}x{image.height} px; give images of one size")
        pattern = find_pattern(image)
        region = choose_region(pattern, image)
        text = write_starter_case(output, reference, deformed, pattern, region)
        with replaced_on_exit(output) as temporary:
            temporary.write_text(text, encoding="utf-8")
    click.echo(f"{'pattern':<20}on {pattern.has_texture.mean():.0%} of the image, features "
               f"{pattern.feature_size:.1f} px wide")
    click.echo(f"{'region':<20}{', '.join(map(str, region))} px, elements of {pattern.choose_element_size()} px")
    click.echo(f"{'case':<20}{output}: look at it, then ddic check {output} --plot mesh.png")


def _require_new(output: Path) -> None:
    """Raise InputError where a case file cannot be written under that name, or one is there."""
    if output.suffix != ".toml":
        raise InputError(f"--output {output}: the name of a case file ends in .toml")
    if output.exists():
        raise InputError(f"{output}: is there already; remove it, or give another --output")
    if not output.absolute().parent.is_dir():
        raise InputError(f"--output {output}: its folder does not exist; create it")
