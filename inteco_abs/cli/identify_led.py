"""The verb `inteco-abs identify-led`."""

from __future__ import annotations

import time
from pathlib import Path

import click

from inteco_abs.cli.options import Finite, shared_option
from inteco_abs.cli.terminal import say
from inteco_abs.errors import BoardError, ConfigError


@click.command("identify-led")
@click.option("--board", default="usb2:", show_default=True, help="Board address, as in usb2:123.")
@click.option("--seconds", default=3.0, show_default=True, type=Finite(0.1, 60, unit="s"), help="Duration.")
@shared_option("config")
def identify_led(board: str, seconds: float, config: Path | None) -> int:
    """Light the LED of an RT-DAC/USB2 to identify the board.

    It is the middle LED; the outputs do not change.
    """
    from inteco_abs.boards import check_address, default_profile, family_of, simulated
    from inteco_abs.config import load_config

    check_address(board)
    name, _, rest = board.partition(":")
    switch = None if simulated(board) else family_of(name).identify_led
    if switch is None:
        raise ConfigError.of("--board", f"{board!r}: only an RT-DAC/USB2 has this LED; name one, as in usb2:123")
    rig = load_config(config, profile=default_profile(board))
    if not switch(rest, rig, True):
        raise BoardError("the board refuses to switch its LED")
    say(f"the LED is on for {seconds:g} s", err=True)
    try:
        time.sleep(seconds)
    finally:
        switch(rest, rig, False)
    return 0
