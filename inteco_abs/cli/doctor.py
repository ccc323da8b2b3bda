"""The verb `inteco-abs doctor`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from inteco_abs.cli.options import FILE, LOSSES, Finite, json_option, shared_option
from inteco_abs.cli.terminal import print_json, say, show
from inteco_abs.errors import BoardError, ConfigError
from inteco_abs.posix import require_linux

if TYPE_CHECKING:
    from inteco_abs.host import CheckResult


@click.command()
@click.option(
    "--seconds",
    default=2.0,
    show_default=True,
    type=Finite(unit="s"),
    help="Duration of the wake-up test; 60 finds rarer delays.",
)
@click.option(
    "--sessions", type=FILE, default=Path("sessions"), show_default=True, help="Folder for sessions, to test its disk."
)
@click.option("--rules", "printed", flag_value="rules", help="Print only the udev rules, for sudo tee.")
@click.option(
    "--ftdi-serial",
    metavar="NUMBER",
    help="With --rules: serial number of the FTDI chip of a first-generation RT-DAC/USB.",
)
@click.option("--limits", "printed", flag_value="limits", help="Print only the limits file, for sudo tee.")
@click.option("--board", help="Also measure the exchange time of this board; its outputs stay off.")
@shared_option("config")
@json_option
def doctor(
    seconds: float,
    sessions: Path,
    printed: str | None,
    ftdi_serial: str | None,
    board: str | None,
    config: Path | None,
    as_json: bool,
) -> int:
    """Check whether this computer can run the rig.

    It lists what to change and changes nothing. Do not use it during a run: its test takes the loop's core. Ends with
    0 if all is green or amber, with 3 if something is red.
    """
    from inteco_abs.boards import check_address, default_profile
    from inteco_abs.config import load_config
    from inteco_abs.experiment import measure_round_trips
    from inteco_abs.host import CheckResult, Computer, Rating, needed_files, red, worst
    from inteco_abs.host.doctor import examine, write_speed
    from inteco_abs.host.latency import LONGEST_S, SHORTEST_S, examine_wake_ups, judge_round_trips
    from inteco_abs.realtime.processes.round_trips import COUNT

    rules, limits = needed_files(Computer(), _serial(ftdi_serial, with_rules=printed == "rules"))
    files = {"rules": rules.text, "limits": limits.text}
    if printed:
        if as_json:
            print_json({"schema_version": 1, printed: files[printed]})
        else:
            say(files[printed], nl=False)  # the text alone, for sudo tee
        return 0
    require_linux("a loop in real time, for which doctor checks a computer,", "virtual runs and sessions need no check")
    if not SHORTEST_S <= seconds <= LONGEST_S:
        raise ConfigError.of("--seconds", f"{seconds:g}: must be {SHORTEST_S:g}..{LONGEST_S:g} s")
    if board is not None:
        check_address(board)
    rig = load_config(config, profile=default_profile(board or "sim:"))
    if sessions.exists() and not sessions.is_dir():
        raise ConfigError.of("--sessions", f"{sessions}: is a file; name a folder")
    findings = examine(sessions)
    say(f"measuring for {seconds:g} s", err=True)
    findings += [write_speed(sessions), *examine_wake_ups(seconds)]
    times_us: list[float] = []
    if board is not None:
        try:
            times_us, engines = measure_round_trips(rig, board)
        except BoardError as error:  # the rest of the report says why
            findings.append(CheckResult("round trips", *red(str(error), "see the lines above")))
        else:
            findings.append(
                CheckResult("round trips", *judge_round_trips(times_us, COUNT, rig.period_ns * 1e-3, engines))
            )
    verdict = worst(findings)
    if as_json:
        print_json({"schema_version": 1, "verdict": verdict, "findings": [one._asdict() for one in findings], **files})
    else:
        _print_findings(findings, times_us, rig.period_ns * 1e-3)
    return LOSSES if verdict is Rating.RED else 0


def _print_findings(findings: Sequence[CheckResult], times_us: Sequence[float], period_us: float) -> None:
    from inteco_abs.views.findings import render_findings, render_histogram

    show(render_findings(findings))
    if times_us:
        show("\nround trips:", render_histogram(times_us, period_us))


def _serial(ftdi_serial: str | None, *, with_rules: bool) -> str:
    """Serial number of the FTDI chip for the rules; empty without one. Raises ConfigError."""
    from inteco_abs.host import check_serial

    if ftdi_serial is None:
        return ""
    if not with_rules:
        raise ConfigError.of("--ftdi-serial", "only with --rules, whose text it changes; add --rules")
    return check_serial(ftdi_serial)
