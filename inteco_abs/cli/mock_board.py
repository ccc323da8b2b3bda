"""The verb `inteco-abs mock-board`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import click

from inteco_abs.cli.options import FILE, Finite, Whole, shared_option
from inteco_abs.cli.terminal import say
from inteco_abs.errors import ConfigError, describe_disk


@click.command("mock-board")
@click.option("--board", "kind", metavar="FAMILY", help="Board family; default: usb2, or usb with --pty.")
@click.option(
    "--usbip",
    "address",
    is_flag=False,
    flag_value="",
    metavar="[HOST:PORT]",
    help="Serve it as a USB device to any Linux with vhci_hcd; default: the loopback address, port 3240.",
)
@click.option(
    "--pty",
    "link",
    is_flag=False,
    flag_value="",
    metavar="[LINK]",
    help="Serve it as a serial port, with the symbolic link LINK to it.",
)
@click.option(
    "--serial", default=900_000_001, show_default=True, type=Whole(), help="Serial number of the board, decimal."
)
@shared_option("seed")
@click.option(
    "--from-report",
    "report",
    type=FILE,
    metavar="FILE",
    help="Imitate the board of a report (commission --send-report): descriptors, header and first image.",
)
@shared_option("rig")
@shared_option("config")
@click.option("--truth", metavar="FILE", help="Write the rig's true state to FILE as JSON lines; - is stdout.")
@click.option(
    "--truth-hz", default=20.0, show_default=True, type=Finite(0.1, 1000, unit="Hz"), help="Lines per second."
)
def mock_board(
    kind: str | None,
    address: str | None,
    link: str | None,
    serial: int,
    seed: int,
    report: Path | None,
    rig: str | None,
    config: Path | None,
    truth: str | None,
    truth_hz: float,
) -> int:
    """Run a mock RT-DAC board with a simulated rig.

    It runs in real time until Ctrl-C; its data are simulated, not measured.
    """
    from functools import partial

    from inteco_abs.api.configuration import setting_lines
    from inteco_abs.boards import family_of, kind_check
    from inteco_abs.commissioning.board_from_report import ReportedBoard
    from inteco_abs.config import load_config
    from inteco_abs.mock_board import rig_check
    from inteco_abs.mock_board_process import Mock, serve_pty, serve_usbip
    from inteco_abs.population_file import rig_settings

    if (address is None) == (link is None):
        raise ConfigError.of("--usbip, --pty", "name one of them: a USB device or a serial port")
    seen = None if report is None else ReportedBoard(report)
    if seen is not None and kind not in {None, seen.report.kind}:
        raise ConfigError.of("--board", f"{kind}: the report is of a {seen.report.kind} board; omit --board")
    kind = _pluggable(seen.report.kind if seen is not None else kind, at_pty=link is not None)
    settings = [*(seen.settings if seen is not None else ()), *setting_lines(rig_settings(rig, "--rig"))]
    configured = load_config(config, settings, [kind_check, rig_check], family_of(kind).mock_profile)
    if configured.board.kind != kind:
        raise ConfigError.of(
            "board.kind", f"{configured.board.kind!r}: the mock is to be {kind!r}; name another profile"
        )
    with _truth_file(truth) as file:
        mock = Mock(configured, seed, file, truth_hz, seen)
        talk = partial(say, err=truth == "-")  # data go to stdout, talk to stderr
        if link is None:
            serve_usbip(mock, address or "", serial, talk)
        else:
            serve_pty(mock, link, talk)
    return 0


def _pluggable(kind: str | None, *, at_pty: bool) -> str:
    """`kind`, or the first family whose mock board can be plugged in that way; raises ConfigError if it cannot."""
    from inteco_abs.boards import FAMILIES, family_of
    from inteco_abs.mock_board import mock_family

    def fits(name: str) -> bool:
        mock = mock_family(name)
        return (mock.stream if at_pty else mock.usb_device) is not None

    if kind is None or (kind in FAMILIES and fits(kind)):
        return kind or next(name for name in FAMILIES if fits(name))
    family = family_of(kind)
    if at_pty and mock_family(kind).usb_device is not None:
        known = ", ".join(name for name in FAMILIES if fits(name))
        raise ConfigError.of("--board", f"{kind}: not a serial port; use --pty with --board {known}")
    problem = f"{kind}: its mock cannot be plugged in; use run --board sim: --set profile={family.mock_profile}"
    raise ConfigError.of("--board", problem)


@contextmanager
def _truth_file(name: str | None) -> Iterator[TextIO | None]:
    """Where the mock's true state goes."""
    if name is None or name == "-":
        yield sys.stdout if name else None
        return
    try:
        file = Path(name).open("w", encoding="utf-8", newline="\n")  # noqa: SIM115  closed below; what is raised inside is not ours
    except OSError as error:
        raise ConfigError.of("--truth", f"{name}: cannot be written: {describe_disk(error)}") from error
    with file:
        yield file
