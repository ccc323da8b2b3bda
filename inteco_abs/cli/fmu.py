"""The verb `inteco-abs fmu`."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import FILE, RunOptions, run_options
from inteco_abs.cli.terminal import say


@click.command()
@click.argument("out", type=FILE)
@run_options("rig", "config", "settings")
@click.option(
    "--fmi",
    default="2.0",
    show_default=True,
    type=click.Choice(("2.0", "3.0")),
    help="Version of the standard; 2.0 is read by more tools.",
)
def fmu(out: Path, options: RunOptions, fmi: str) -> int:
    """Write the simulated rig for other simulation tools.

    OUT.fmu is a Functional Mock-up Unit for co-simulation: the rig's physics and encoders as machine code for this
    kind of computer, with their source in C. The rig is that of [simulation], or a sampled one; its numbers are
    parameters. Needs a C compiler, the command cc.
    """
    from inteco_abs.interfaces.fmu import export_fmu
    from inteco_abs.mock_board import simulated_rig

    export_fmu(out, simulated_rig(options.load()), fmi=fmi)
    say(f"{out}: FMI {fmi}, co-simulation in steps of 0.5 ms")
    return 0
