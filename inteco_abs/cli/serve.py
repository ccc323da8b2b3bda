"""The verb `inteco-abs serve`."""

from __future__ import annotations

import secrets
import sys
from functools import partial
from pathlib import Path
from typing import Any, Final

import click

from inteco_abs.cli.options import FILE, RunOptions, Whole, known_controllers, run_options
from inteco_abs.cli.terminal import say
from inteco_abs.errors import AbsError

_PORT: Final = 8770


@click.command()
@click.argument("folder", type=FILE, required=False)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to serve at; 0.0.0.0: all networks.")
@click.option("--port", default=_PORT, show_default=True, type=Whole(0, 65535), help="Port; 0: any free one.")
@click.option(
    "--allow-board",
    "boards",
    multiple=True,
    metavar="ADDRESS",
    help="Let browsers on this computer run the rig at this board, with all that `run` checks.",
)
@run_options(
    controller="Also offer your own controller, as file.py:Class, or choose another at first.",
    estimator="Estimator at first.",
    config="Configuration of all runs.",
    settings="Set a value of all runs, as guard.brake_limit=0.7.",
)
def serve(folder: Path | None, host: str, port: int, boards: tuple[str, ...], options: RunOptions) -> int:
    """Serve runs and sessions to a browser.

    It shows a run while it lasts, starts and stops runs on the simulated board, changes gains meanwhile, and lists the
    sessions of FOLDER (default: sessions) with reports and figures. It prints the address to open, which holds a
    secret. Each run is a process of its own, as of `inteco-abs run`; Ctrl-C ends it in SAFE and then the server. Needs
    the extra `serve`; reports need `report`, figures `figures`.
    """
    import asyncio

    from inteco_abs.analysis import session_files
    from inteco_abs.boards import check_address

    try:
        from inteco_abs.browser import serve as serve_folder
    except ImportError as error:
        raise AbsError("serve needs aiohttp: pip install 'inteco-abs[serve]'") from error
    if folder is not None:
        session_files(folder)  # it must be there
    for board in boards:
        check_address(board)
    served = _served(folder or Path("sessions"), boards, options, host, port)
    if not served.local:
        say(
            f"inteco-abs: {host} can be reached from the network, without encryption: whoever has the address below "
            "can start simulated runs and stop all; use a trusted network, or ssh -L with the default host",
            err=True,
        )
    try:
        asyncio.run(serve_folder(served, _announce, partial(say, err=True)))
    except KeyboardInterrupt:
        say("inteco-abs: the server has ended", err=True)
    return 0


def _announce(address: str) -> None:
    say(address)
    sys.stdout.flush()  # another program may wait for it
    say("inteco-abs: open this address in a browser; Ctrl-C ends the server, and a run in SAFE", err=True)


def _served(folder: Path, boards: tuple[str, ...], options: RunOptions, host: str, port: int) -> Any:
    """What the browser may choose, and what holds for all runs. Raises ConfigError for what `run` would refuse."""
    from inteco_abs.browser import Served
    from inteco_abs.control import ESTIMATORS, control_check, preferred_estimator, reference_gain
    from inteco_abs.plugins import installed_controllers

    controllers = known_controllers(options.controller)
    config = options.load(options.chosen, checks=[control_check(controllers)], follows=preferred_estimator(controllers))
    usable, _ = installed_controllers().usable()
    chosen = config.controller
    own = controllers[chosen.name].gains
    gains = {name: kind.gains for name, (kind, _) in usable.items()}
    gains[chosen.name] = tuple(gain._replace(default=chosen.gains.get(gain.name, gain.default)) for gain in own)
    settings = (f"--set={setting}" for setting in options.settings)
    return Served(
        folder=folder.absolute(),
        boards=tuple(dict.fromkeys(["sim:", *boards])),
        controllers=gains,
        estimators=tuple(ESTIMATORS),
        start={
            "controller": chosen.name,
            "estimator": options.estimator or "",
            "reference": reference_gain(chosen.reference_slip)._asdict(),
            "speed": config.experiment.start_speed_rad_s,
            "real_time": sys.platform.startswith("linux"),
        },
        arguments=(*([f"--config={options.config.absolute()}"] if options.config is not None else []), *settings),
        host=host,
        port=port,
        token=secrets.token_urlsafe(16),
    )
