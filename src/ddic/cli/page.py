"""``ddic draw`` and ``ddic view``: pages in the browser, of the extra ddic[page]."""

from functools import partial
from pathlib import Path

import click

from ddic.cli.failures import failures_as_lines, warnings_as_lines
from ddic.page import require_page

PORT = click.option("--port", type=click.IntRange(0, 65535), default=0,
                    help="Of the page on this machine; a free one by default.")
BROWSER = click.option("--browser/--no-browser", default=True, help="Open the page in this machine's browser.")


@click.command()
@click.argument("image", metavar="IMAGE", type=click.Path(path_type=Path))
@click.argument("case_file", metavar="[CASE.toml]", required=False, default=Path("case.toml"),
                type=click.Path(path_type=Path, dir_okay=False))
@click.option("--deformed", multiple=True, type=click.Path(path_type=Path), metavar="IMAGE",
              help="Image after loading, named in a case that is new; several for a series.")
@PORT
@BROWSER
def draw(image: Path, case_file: Path, deformed: tuple[Path, ...], port: int, *, browser: bool) -> None:
    """Draw region, holes, masks, lines and probes on the reference IMAGE in the browser; write CASE.toml, and run it.

    A CASE.toml that is there is opened, and only what is drawn anew changes in it.
    """
    with failures_as_lines(case_file), warnings_as_lines():
        require_page()
        # Imported here because they bring the server, which --help does not need.
        from ddic.page.draw import make_draw_page
        from ddic.page.drawn_case import open_drawn_case
        from ddic.page.server import run_server

        drawn = open_drawn_case(image, case_file, deformed)
        run_server(partial(make_draw_page, drawn), port, _announce, opens_browser=browser)


@click.command()
@click.argument("files", metavar="RESULT...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--probes", type=click.Path(path_type=Path), help="File of probes, as of ddic probe.")
@PORT
@BROWSER
def view(files: tuple[Path, ...], probes: Path | None, port: int, *, browser: bool) -> None:
    """Look at results in the browser: fields over the images, values, profiles, curves over a series, exports."""
    with failures_as_lines(files[0]), warnings_as_lines():
        require_page()
        from ddic.page.server import run_server
        from ddic.page.view import make_view_page, open_results
        from ddic.probes.probes import load_probes

        named = [] if probes is None else load_probes(probes)
        open_results(files)
        run_server(partial(make_view_page, files, named), port, _announce, opens_browser=browser)


def _announce(address: str) -> None:
    click.echo(f"{'page':<20}{address}")
    port = address.partition("localhost:")[2].partition("/")[0]
    click.echo(f"{'from elsewhere':<20}ssh -L {port}:localhost:{port} THIS_MACHINE, then the same address")
    click.echo(f"{'end':<20}Ctrl-C; what runs goes on")
