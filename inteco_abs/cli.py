"""The command `inteco-abs`. Data goes to stdout, talk to stderr.

Exit codes: 0 done, 1 failed, 2 wrong usage or configuration, 3 done with losses, overruns or red findings to look at,
4 replay differs, 5 safety stop, 130 interrupted.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO

import click

from inteco_abs.errors import AbsError, ConfigError, Mistake, near_match
from inteco_abs.lab_cli import probe
from inteco_abs.wire_cli import wire

if TYPE_CHECKING:
    from inteco_abs.control import Controller
    from inteco_abs.experiment import Progress
    from inteco_abs.realtime.findings import Finding
    from inteco_abs.realtime.screen import Screen, Snapshot
    from inteco_abs.sessions import Account, Replay, Session

_LOSSES: Final = 3
_DIFFERS: Final = 4
_INTERRUPTED: Final = 130
_FILE: Final = click.Path(path_type=Path)
_CUSTOM: Final = ".py:"
_MOCK_PROFILES: Final = {"usb2": "sim_usb2", "usb": "sim_usb"}


class _Verbs(click.Group):
    """Group that suggests the nearest verb."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.commands:
            raise click.UsageError(f"no command {args[0]!r}{near_match(args[0], self.commands)}", ctx)
        return super().resolve_command(ctx, args)


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="inteco-abs")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """Driver, controller and laboratory for the Inteco anti-lock braking rig."""


def _json_option(function: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead.")(function)


@cli.command()
@click.option("--board", default="sim:", show_default=True, help="Board address; sim: is the mock board.")
@click.option("--virtual", is_flag=True, help="Virtual time: as fast as it goes, and repeatable.")
@click.option(
    "--seed",
    default=0,
    show_default=True,
    type=click.IntRange(min=0),
    help="What differs between two power-ups of the mock board.",
)
@click.option("--config", type=_FILE, help="rig.toml; every key has a default.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Over the file, as in guard.brake_limit=0.7.",
)
@click.option("--controller", help="reaching-law, relay, or your own as file.py:Class.")
@click.option("--estimator", help="moving-window, or euler as in the paper.")
@click.option("--out", type=_FILE, help="Session file to write; default: sessions/stop-TIME.mcap.")
@click.option("--figure", type=_FILE, help="Also draw the stop: .png, .svg or .pdf.")
@click.option(
    "--record-wire", "wire", type=_FILE, help="Also write every message to and from the board, as JSON lines."
)
@_json_option
def run(
    board: str,
    virtual: bool,
    seed: int,
    config: Path | None,
    settings: tuple[str, ...],
    controller: str | None,
    estimator: str | None,
    out: Path | None,
    figure: Path | None,
    wire: Path | None,
    as_json: bool,
) -> int:
    """Drive, brake, record: one stop."""
    from inteco_abs.boards import check_address, default_profile
    from inteco_abs.config import load_config
    from inteco_abs.control import CONTROLLERS, control_check
    from inteco_abs.experiment import Plan, run_stop
    from inteco_abs.views.figure import check_figure

    controllers, source = _controllers(controller, CONTROLLERS)
    chosen = [f"{key}.name={name}" for key, name in (("controller", controller), ("estimator", estimator)) if name]
    check_address(board)
    rig = load_config(config, [*settings, *chosen], [control_check(controllers)], default_profile(board))
    out = out or _default_out()
    if figure is not None:
        check_figure(figure)
        if figure.resolve() == out.resolve():
            raise ConfigError([Mistake("--figure", f"{figure}: is the session's own file; choose another name")])
    plan = Plan(out, board, virtual, seed, controllers, source, wire)
    if virtual:
        with _progress() as progress:
            stop = run_stop(rig, plan, progress)
    else:
        _tell_of_left_rings()
        with _screen(rig.experiment.start_speed_rad_s) as screen:
            stop = run_stop(rig, plan, screen=screen)
    try:
        _tell(stop, as_json=as_json)
    except OSError:  # the terminal is gone: how the run ended matters more
        sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  until the process ends
        return stop.exit_code or 1
    if figure is not None and stop.card["start_speed_rad_s"] is not None:
        try:
            _draw(out, figure)
        except AbsError as error:  # how the run ended matters more than its picture
            click.echo(f"inteco-abs: {error}", err=True)
            return stop.exit_code or error.exit_code
    return stop.exit_code


@cli.command()
@click.argument("file", type=_FILE)
@click.option("--controller", help="Your own controller as file.py:Class, if the session was run with one.")
@_json_option
def replay(file: Path, controller: str | None, as_json: bool) -> int:
    """Run the decisions of a session again and compare them bit for bit."""
    from dataclasses import asdict

    from inteco_abs.control import CONTROLLERS, build_pipeline, control_check
    from inteco_abs.sessions import read_session, session_config
    from inteco_abs.sessions import replay as run_again

    session = _read(file, read_session)
    controllers, source = _controllers(controller, CONTROLLERS)
    name = session.metadata.get("controller", {}).get("name", "")
    if controller is not None:
        if controller not in controllers:
            raise ConfigError(
                [Mistake("--controller", f"no controller {controller!r}{near_match(controller, controllers)}")]
            )
        controllers = {**controllers, name: controllers[controller]}
        if source != session.attachments.get("controller.py", source):
            click.echo("inteco-abs: the controller's source is not the one that the session was run with", err=True)
    elif _CUSTOM in name:
        raise ConfigError([Mistake("--controller", f"the session was run with {name!r}; name that file to replay it")])
    config = session_config(session, (control_check(controllers),))
    outcome = run_again(session, build_pipeline(config, controllers))
    report = {"schema_version": 1, "session": str(file), "incomplete": session.incomplete, **asdict(outcome)}
    if as_json:
        _print_json(report)
    else:
        _print_replay(file, outcome)
    return _DIFFERS if outcome.differing else _LOSSES if session.incomplete else 0


@cli.command()
@click.argument("file", type=_FILE)
@_json_option
def info(file: Path, as_json: bool) -> int:
    """What a session holds, how it ended, and with what it was run."""
    from inteco_abs.sessions import read_session

    session = _read(file, read_session)
    summary = _summary(session)
    if as_json:
        _print_json(summary)
    else:
        _print_summary(summary)
    return _LOSSES if session.incomplete else 0


@cli.command()
@click.argument("ring", type=_FILE)
@click.option("--out", "-o", type=_FILE, required=True, help="Session file to write.")
@_json_option
def recover(ring: Path, out: Path, as_json: bool) -> int:
    """Write the session of a run whose processes all crashed, from the memory that it left in RING."""
    from inteco_abs.realtime.recorder import recover_run

    account = recover_run(ring, out)
    if as_json:
        _print_json(account.card)
    else:
        _print_card(account.card, account.explanation)
    return _LOSSES if account.card["lost_ticks"] else 0


@cli.command()
@click.argument("file", type=_FILE)
@click.option("--out", "-o", type=_FILE, required=True, help="Figure to write: .png, .svg or .pdf.")
def figure(file: Path, out: Path) -> int:
    """Draw a session: speeds, slip, brake."""
    _draw(file, out)
    return 0


@cli.command("mock-board")
@click.option(
    "--board", "kind", type=click.Choice(["usb2", "usb", "pci"]), help="Which; default: usb2, or usb at a pty."
)
@click.option(
    "--usbip",
    "address",
    is_flag=False,
    flag_value="",
    metavar="[HOST:PORT]",
    help="Serve it as a USB device to any Linux with vhci_hcd; by default on the loopback address, port 3240.",
)
@click.option(
    "--pty",
    "link",
    is_flag=False,
    flag_value="",
    metavar="[LINK]",
    help="Be a serial port instead, and make the symbolic link LINK to it.",
)
@click.option("--serial", default=900_000_001, show_default=True, type=int, help="Its decimal serial number.")
@click.option(
    "--seed", default=0, show_default=True, type=click.IntRange(min=0), help="What differs between two power-ups."
)
@click.option("--config", type=_FILE, help="rig.toml; every key has a default.")
@click.option("--truth", metavar="FILE", help="Write the rig's true state there as JSON lines; - is stdout.")
@click.option(
    "--truth-hz", default=20.0, show_default=True, type=click.FloatRange(0.1, 1000.0), help="How many lines a second."
)
def mock_board(
    kind: str | None,
    address: str | None,
    link: str | None,
    serial: int,
    seed: int,
    config: Path | None,
    truth: str | None,
    truth_hz: float,
) -> int:
    """Be an RT-DAC board with the rig on it, in real time, until Ctrl-C; its data are no measurements."""
    from functools import partial

    from inteco_abs.config import load_config
    from inteco_abs.simulator import Mock, serve_pty, serve_usbip

    if (address is None) == (link is None):
        raise ConfigError([Mistake("mock-board", "name one of --usbip, a USB device, and --pty, a serial port")])
    kind = kind or ("usb2" if link is None else "usb")
    _insist_on_plug(kind, at_pty=link is not None)
    rig = load_config(config, profile=_MOCK_PROFILES[kind])
    if rig.board.kind != kind:
        raise ConfigError(
            [Mistake("board.kind", f"{rig.board.kind!r}: the mock is to be {kind!r}; name another profile")]
        )
    with _truth_file(truth) as file:
        mock = Mock(rig, seed, file, truth_hz)
        say = partial(click.echo, err=truth == "-")  # data go to stdout, talk to stderr
        if link is None:
            serve_usbip(mock, address or "", serial, say)
        else:
            serve_pty(mock, link, say)
    return 0


@cli.command()
@click.option(
    "--seconds", default=2.0, show_default=True, type=float, help="Length of the wake-up test; 60 tells more."
)
@click.option(
    "--sessions", type=_FILE, default=Path("sessions"), show_default=True, help="Where sessions will be written."
)
@click.option("--rules", "printed", flag_value="rules", help="Print only the udev rules, for sudo tee.")
@click.option("--limits", "printed", flag_value="limits", help="Print only the limits file, for sudo tee.")
@click.option("--board", help="Also measure how long exchanges with this board take; its outputs stay off.")
@click.option("--config", type=_FILE, help="rig.toml that names the board's profile.")
@_json_option
def doctor(
    seconds: float, sessions: Path, printed: str | None, board: str | None, config: Path | None, as_json: bool
) -> int:
    """Tell whether this computer is fit for the rig, and what to do about it.

    Changes nothing. Not for use during a run: its test takes the loop's place. Ends with exit code 0 when all is green
    or amber, with 3 when something is red.
    """
    from inteco_abs.boards import check_address, default_profile
    from inteco_abs.config import load_config
    from inteco_abs.experiment import exchange_times_us
    from inteco_abs.realtime.doctor import examine, write_speed
    from inteco_abs.realtime.findings import Computer, Finding, Verdict, worst
    from inteco_abs.realtime.latency import LONGEST_S, SHORTEST_S, examine_wake_ups, judge_round_trips
    from inteco_abs.realtime.permissions import limits, serial_group, udev_rules
    from inteco_abs.realtime.trips import COUNT

    group = serial_group(Computer())
    files = {"rules": udev_rules(group), "limits": limits(group)}
    if printed:
        click.echo(files[printed], nl=False)
        return 0
    if not SHORTEST_S <= seconds <= LONGEST_S:
        raise ConfigError([Mistake("--seconds", f"{seconds:g}: must be {SHORTEST_S:g}..{LONGEST_S:g} s")])
    if board is not None:
        check_address(board)
    rig = load_config(config, profile=default_profile(board or "sim:"))
    if sessions.exists() and not sessions.is_dir():
        raise ConfigError([Mistake("--sessions", f"{sessions}: is a file; name a folder")])
    findings = examine(sessions)
    click.echo(f"measuring for {seconds:g} s", err=True)
    findings += [write_speed(sessions), *examine_wake_ups(seconds)]
    times_us: list[float] = []
    if board is not None:
        times_us = exchange_times_us(rig, board)
        findings.append(Finding("round trips", *judge_round_trips(times_us, COUNT, rig.period_ns * 1e-3)))
    verdict = worst(findings)
    if as_json:
        _print_json({"schema_version": 1, "verdict": verdict, "findings": [one._asdict() for one in findings], **files})
    else:
        _print_findings(findings)
        if times_us:
            _print_histogram(times_us, rig.period_ns * 1e-3)
    return _LOSSES if verdict is Verdict.RED else 0


cli.add_command(probe)
cli.add_command(wire)


def main() -> None:
    """Entry point of the command: maps every way to end to its exit code, without a traceback."""
    debug = "--debug" in sys.argv
    try:
        code = cli.main(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except AbsError as error:
        if debug:
            raise
        for line in (str(error), *getattr(error, "__notes__", ())):
            click.echo(f"inteco-abs: {line}", err=True)
        code = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo("inteco-abs: interrupted", err=True)
        code = _INTERRUPTED
    except OSError as error:  # the output went away: a closed pipe, a full disk
        sys.stdout = sys.stderr
        click.echo(f"inteco-abs: the output cannot be written: {error.strerror}", err=True)
        code = 1
    except Exception as error:  # the top of the process: a bug must not look like the user's mistake
        if debug:
            raise
        click.echo(
            f"inteco-abs: internal error, please report it: {type(error).__name__}: {error}\n"
            "  inteco-abs --debug ... shows where",
            err=True,
        )
        code = 1
    sys.exit(code)


def _read(file: Path, reader: Callable[[Path], Session]) -> Session:
    session = reader(file)
    if session.incomplete:
        click.echo(f"inteco-abs: {file}: {session.incomplete}; {len(session.ticks)} ticks are whole", err=True)
    return session


def _draw(file: Path, out: Path) -> None:
    from inteco_abs.sessions import read_session
    from inteco_abs.views.figure import check_figure, draw_stop

    check_figure(out)
    draw_stop(_read(file, read_session), out)
    click.echo(f"figure: {out}", err=True)


def _controllers(
    name: str | None, shipped: Mapping[str, type[Controller]]
) -> tuple[Mapping[str, type[Controller]], bytes]:
    """Controllers to choose from, with the user's own if `name` is `file.py:Class`, and its source."""
    if name is None or _CUSTOM not in name:
        if name is not None and name.endswith(".py"):
            raise ConfigError([Mistake("--controller", f"{name}: name the class too, as in {name}:Class")])
        return shipped, b""
    from inteco_abs.plugins import load_controller

    kind, source = load_controller(name)
    return {**shipped, name: kind}, source


def _default_out() -> Path:
    folder = Path("sessions")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise ConfigError(
            [Mistake("--out", f"no folder {folder} can be made here ({error.strerror}); name a file")]
        ) from error
    return folder / f"stop-{datetime.now().astimezone():%Y%m%d-%H%M%S-%f}.mcap"


def _tell(stop: Account, *, as_json: bool) -> None:
    if as_json:
        _print_json(stop.card)
    else:
        _print_card(stop.card, stop.explanation)
    if stop.outcome != "completed":
        click.echo(f"inteco-abs: {stop.outcome}: {stop.explanation}", err=True)
    elif stop.exit_code:
        lost = f"{stop.card['overruns']} periods overrun, {stop.card['link_errors']} exchanges failed"
        click.echo(f"inteco-abs: completed, but look at it: {lost}", err=True)


def _insist_on_plug(kind: str, *, at_pty: bool) -> None:
    """Raise ConfigError unless a mock board of this kind can be plugged in that way."""
    if kind == "pci":
        problem = "no PCI board can be plugged in from outside; for its mock: run --board sim: --set profile=sim_pci"
        raise ConfigError([Mistake("--board", problem)])
    if at_pty and kind != "usb":
        raise ConfigError([Mistake("--board", f"{kind}: is no serial port; --pty goes with --board usb")])


@contextmanager
def _truth_file(name: str | None) -> Iterator[TextIO | None]:
    """Where the mock's true state goes."""
    if name is None or name == "-":
        yield sys.stdout if name else None
        return
    try:
        file = Path(name).open("w", encoding="utf-8")  # noqa: SIM115  closed below; what is raised inside is not ours
    except OSError as error:
        raise ConfigError([Mistake("--truth", f"{name}: cannot be written: {error.strerror}")]) from error
    with file:
        yield file


class _Lines:
    """Shows a run where there is no terminal: what cannot wait, and nothing else."""

    def show(self, snapshot: Snapshot) -> None:
        """Nothing: a log is no place for ten lines a second."""

    def warn(self, text: str) -> None:
        """One line."""
        click.echo(f"inteco-abs: {text}", err=True)


@contextmanager
def _screen(full_speed_rad_s: float) -> Iterator[Screen]:
    """Live picture of a real-time run on a terminal's stderr, else one line before it."""
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        click.echo("running in real time; Ctrl-C stops safely", err=True)
        yield _Lines()
        return
    from rich.console import Console

    from inteco_abs.views.dashboard import Dashboard

    with Dashboard(Console(stderr=True), full_speed_rad_s) as dashboard:
        yield dashboard


def _tell_of_left_rings() -> None:
    """A run that crashed altogether has left its ticks in memory; the next one must not let them be forgotten."""
    from inteco_abs.realtime.memory import left_rings

    for ring in left_rings():
        click.echo(
            f"inteco-abs: a run that crashed has left its ticks in {ring}: inteco-abs recover {ring} --out FILE",
            err=True,
        )


@contextmanager
def _progress() -> Iterator[Progress | None]:
    """Phase and ticks so far of a virtual run, on a terminal's stderr."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda phase, ticks: status.update(f"{phase.name.lower().replace('_', '-')}, {ticks} ticks")


def _summary(session: Session) -> dict[str, Any]:
    ticks = session.ticks
    seconds = (int(ticks["time_ns"][-1]) - int(ticks["time_ns"][0])) * 1e-9 if len(ticks) else 0.0
    result = session.metadata.get("result", {}).get("card")
    return {
        "schema_version": 1,
        "session": str(session.path),
        "incomplete": session.incomplete,
        "ticks": len(ticks),
        "duration_s": seconds,
        "events": session.events,
        "attachments": {name: len(data) for name, data in session.attachments.items()},
        "metadata": {name: facts for name, facts in session.metadata.items() if name != "result"},
        "result": json.loads(result) if result else None,
    }


def _print_json(data: Mapping[str, Any]) -> None:
    click.echo(json.dumps(data, allow_nan=False))


def _print_card(card: Mapping[str, Any], explanation: str) -> None:
    from rich.console import Console

    from inteco_abs.views import render_card

    Console().print(render_card(card, explanation))


def _print_findings(findings: Sequence[Finding]) -> None:
    from rich.console import Console

    from inteco_abs.views.health import render_findings

    Console().print(render_findings(findings))


def _print_histogram(times_us: Sequence[float], period_us: float) -> None:
    from rich.console import Console

    from inteco_abs.views.health import render_histogram

    Console().print("\nround trips:", render_histogram(times_us, period_us), sep="\n")


def _print_replay(file: Path, outcome: Replay) -> None:
    if outcome.first is None:
        click.echo(f"{file}: {outcome.ticks} ticks ({outcome.braking_ticks} braking) replayed, none differs")
        return
    first = outcome.first
    click.echo(
        f"{file}: {outcome.differing} of {outcome.ticks} ticks differ, first at tick {first.tick}: {first.field}"
    )
    click.echo(f"  logged   {first.logged}  {first.logged_hex}")
    click.echo(f"  replayed {first.replayed}  {first.replayed_hex}")
    for name, count in outcome.by_field.items():
        click.echo(f"  {name}: {count} ticks")


def _print_summary(summary: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for key in ("session", "ticks", "duration_s", "events"):
        table.add_row(key, str(summary[key]))
    for name, facts in summary["metadata"].items():
        for key, value in facts.items():
            table.add_row(f"{name}.{key}", value)
    for name, size in summary["attachments"].items():
        table.add_row(f"attachment {name}", f"{size} bytes")
    Console(markup=False).print(table)
