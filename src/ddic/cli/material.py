"""Measurements that say more than a field: ``ddic compare``, ``ddic identify`` and ``ddic modes``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.cli.run import measure_everywhere

if TYPE_CHECKING:
    from ddic.parallel.stop_request import StopRequest
    from ddic.parallel.team import Team
    from ddic.results.listener import Listener
    from ddic.results.summary import Summary


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.argument("simulation", required=False, metavar="[SIMULATION]", type=click.Path(path_type=Path))
@click.option("--step", metavar="N|last", help="Step of the simulation, by its number, or the last one.")
@click.option("--time", type=float, metavar="T", help="Step of the simulation, by its time.")
@click.option("--field", metavar="NAME", help="Name of the displacement in the simulation's file.")
@click.option("--fit", type=click.Choice(["nothing", "motion", "placement"]),
              help="What is fitted before: nothing, a rigid motion, or where the simulation lies too.")
@click.pass_obj
def compare(stop: StopRequest | None, case_file: Path, simulation: Path | None, step: str | None, time: float | None,
            field: str | None, fit: str | None) -> None:
    """Measure a pair and compare it with a simulation, levelled; alone or under mpirun.

    The result has the difference at the nodes, in pixels and in standard deviations, and chi^2 by region. What is left
    out here, [simulation] of the case says.
    """
    file = None if simulation is None else simulation.absolute()
    given = {"file": file, "step": _parse_step(step), "time": time, "field": field, "fit": fit}
    said = {key: value for key, value in given.items() if value is not None}

    def work(team: Team, listener: Listener) -> Summary:
        from ddic.methods.material import compare_case

        return compare_case(team, case_file, said, listener)

    measure_everywhere(stop, work)


def _parse_step(text: str | None) -> int | None:
    if text is None or text == "last":
        return None if text is None else -1
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise click.BadParameter(f'{text} is no step: give a number from 1, or "last"', param_hint="--step")
    return number


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.pass_obj
def identify(stop: StopRequest | None, case_file: Path) -> None:
    """Identify the elastic parameters of a case's material from its images and forces; alone or under mpirun.

    Prints them with standard deviations and correlations, and says whether the mesh is fine enough. The result is that
    of the last image, with its difference from the law that was found.
    """

    def work(team: Team, listener: Listener) -> Summary:
        from ddic.methods.material import identify_case

        return identify_case(team, case_file, listener)

    measure_everywhere(stop, work)


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("--number", type=click.IntRange(1), metavar="N",
              help="How many modes there are; left out: as many as stand out from the noise.")
@click.pass_obj
def modes(stop: StopRequest | None, case_file: Path, number: int | None) -> None:
    """Measure the frames of a series together, as a few fields that functions of time multiply; alone or under mpirun.

    Noise of single frames averages out, and the modes take a small part of the room of all fields. The result is that
    of the last frame, with the modes and the amplitudes of all frames.
    """

    def work(team: Team, listener: Listener) -> Summary:
        from ddic.methods.material import measure_modes

        return measure_modes(team, case_file, number, listener)

    measure_everywhere(stop, work)
