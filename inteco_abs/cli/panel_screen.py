"""The manual panel on a terminal. It only shows and requests: another process holds the board."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, ClassVar, Final

from rich.table import Table
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.events import Key
from textual.screen import ModalScreen
from textual.widgets import Static

from inteco_abs.boards import family_of, unconfirmed
from inteco_abs.cli.options import INTERRUPTED
from inteco_abs.cli.terminal import plain
from inteco_abs.commissioning import AGAIN, Output, Panel, hex_dump
from inteco_abs.config import BoardConfig
from inteco_abs.errors import UnsafeError
from inteco_abs.realtime.processes.manual import ManualClient
from inteco_abs.signals import EXPLANATIONS, Command, Reason

_REFRESH_S: Final = 0.1
_LOOK_EVERY: Final = 10
"""Refreshes between two readings of a board whose readings include alarms and cost almost nothing."""
_BAR: Final = 20
_STOPPED: Final = UnsafeError.exit_code
ARM_AGAIN: Final = -1
"""Result of the screen when outputs are to be armed again; not an exit code."""
_GUARDED: Final = "Guarded, but if computer or cable fails only the emergency switch helps."
_KEYS: Final = (
    "[b]space[/] held: power   [b]↑ ↓ PgUp PgDn[/] drive   [b]→ ←[/] brake   [b]0[/] both to zero\n"
    "[b]z[/] counts to zero   [b]d[/] all of the board   [b]q[/] leave   any key but space: power off"
)


class DumpScreen(ModalScreen[None]):
    """One reading of the board: bytes and decoded fields."""

    CSS = """
    DumpScreen > VerticalScroll { border: round $primary; background: $surface; }
    """

    def __init__(self, board: Text, look: dict[str, Any]) -> None:
        super().__init__()
        self._texts = board, Text(f"\n{dump_text(look)}")

    def compose(self) -> ComposeResult:
        """One text to scroll in."""
        with VerticalScroll() as box:
            box.border_title = "the board as it was read: arrows and PgDn scroll, any other key closes"
            yield from map(Static, self._texts)

    def on_key(self, event: Key) -> None:
        """Scroll or close."""
        if event.key not in ("up", "down", "pageup", "pagedown", "home", "end"):
            event.stop()
            self.dismiss()


class AgainScreen(ModalScreen[bool]):
    """Asks whether to arm the outputs again after the guard switched them off; only y means yes."""

    CSS = """
    AgainScreen { align: center middle; }
    AgainScreen > Static { border: heavy $error; background: $surface; width: 76; height: auto; padding: 0 1; }
    """

    def __init__(self, reason: Reason) -> None:
        super().__init__()
        self._reason = reason

    def compose(self) -> ComposeResult:
        """The reason, and what happens next."""
        box = Static(f"The guard switched the outputs off: {EXPLANATIONS[self._reason]}.\n\n{AGAIN}", markup=False)
        box.border_title = "arm again?"
        yield box

    def on_key(self, event: Key) -> None:
        """The hold-to-run key does not count as an answer."""
        event.stop()
        self.dismiss(event.key == "y")


class PanelApp(App[int]):
    """The screen of a panel whose board `side` holds; its result is the exit code, or ARM_AGAIN."""

    TITLE = "inteco-abs panel"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c", f"leave({INTERRUPTED})", priority=True),
        Binding("ctrl+q", "leave(0)", priority=True),
    ]
    CSS = """
    #state { height: 3; padding: 0 1; background: $panel; text-style: bold; }
    #state.on { background: darkorange; color: black; }
    #state.lost { background: darkred; color: white; }
    #both { height: 7; }
    #both Static { border: round $primary; width: 1fr; padding: 0 1; }
    #board { border: round $primary; height: 1fr; padding: 0 1; scrollbar-size: 0 0; }
    #keys { dock: bottom; height: 2; padding: 0 1; }
    """

    def __init__(self, panel: Panel, side: ManualClient, address: str) -> None:
        super().__init__()
        self._panel = panel
        self._side = side
        self._address = address
        self._introduction = side.introduction
        self._facts = Text()
        self._refreshes = 0
        self._dump_wanted = False
        self._look: dict[str, Any] = {}
        self._by_key: dict[str, Callable[[], None]] = {
            "up": lambda: panel.move("drive", 1),
            "down": lambda: panel.move("drive", -1),
            "pageup": lambda: panel.move("drive", 10),
            "pagedown": lambda: panel.move("drive", -10),
            "right": lambda: panel.move("brake", 1),
            "left": lambda: panel.move("brake", -1),
            "0": panel.to_zero,
            "z": panel.zero_counts,
            "d": self._want_dump,
            "r": self._ask_again,
            "q": lambda: self.action_leave(0),
        }

    def compose(self) -> ComposeResult:
        """State, wheels, outputs, board, keys."""
        yield Static(id="state", markup=False)
        with Horizontal(id="both"):
            for name in ("wheels", "outputs"):
                box = Static(id=name)
                box.border_title = name
                yield box
        with VerticalScroll(id="board") as scroll:
            scroll.border_title = "board"
            scroll.can_focus = False
            yield Static(id="facts")
        yield Static(_KEYS, id="keys")

    def on_mount(self) -> None:
        """Start the refresh timer."""
        self.set_interval(_REFRESH_S, self.look)
        self.look()

    def on_key(self, event: Key) -> None:
        """The hold-to-run key counts from when it arrived; every other key switches the power off first."""
        if isinstance(self.screen, ModalScreen):
            return
        if event.key == "space":
            seen_ns = int(event.time * 1e9)
            if self._panel.press(seen_ns):
                self._side.request.keep_on(self._panel.request, seen_ns)
        else:
            self._take_away()
            self._by_key.get(event.key, lambda: None)()
            self._draw()

    def action_leave(self, code: int) -> None:
        """Switch the power off and leave."""
        self._take_away()
        self.exit(_STOPPED if self._panel.reason is not Reason.NONE and not code else code)

    def look(self) -> None:
        """Take in new ticks and show them; leave when no process holds the board."""
        if not self.is_running:
            return  # textual stops an app's timers only after it has taken the screen away
        panel, side = self._panel, self._side
        panel.see(side.ticks())
        if side.over:
            panel.reason = panel.reason or side.reason
            self.exit(INTERRUPTED if panel.reason is Reason.OPERATOR_STOP else _STOPPED)
            return
        self._refreshes += 1
        if family_of(panel.config.board.kind).fast_readings and self._refreshes % _LOOK_EVERY == 0:
            side.ask()
        self._look = side.look or self._look
        if self._dump_wanted and side.answered:
            self._dump_wanted = False
            self.push_screen(DumpScreen(self._board_text(), self._look))
        self._draw()

    def _want_dump(self) -> None:
        self._side.ask()
        self._dump_wanted = True

    def _ask_again(self) -> None:
        if self._panel.tripped:
            self.push_screen(AgainScreen(self._panel.reason), lambda yes: self.exit(ARM_AGAIN) if yes else None)

    def _take_away(self) -> None:
        self._panel.release()
        self._side.request.take_away()

    def _draw(self) -> None:
        panel = self._panel
        if isinstance(self.screen, ModalScreen):
            return
        state = self.query_one("#state", Static)
        state.update(f"{panel.state(time.monotonic_ns())}\n{_GUARDED if panel.outputs else ''}", layout=False)
        state.set_class(panel.admitted != Command.SAFE, "on")
        state.set_class(panel.reason is not Reason.NONE, "lost")
        self.query_one("#wheels", Static).update(wheels_table(panel), layout=False)
        self.query_one("#outputs", Static).update(outputs_text(panel), layout=False)
        facts = self._board_text()
        if facts != self._facts:
            self._facts = facts
            self.query_one("#facts", Static).update(facts)

    def _board_text(self) -> Text:
        return board_text(self._panel, self._address, self._introduction, self._look)


def wheels_table(panel: Panel) -> Table:
    """Counts, turns and speeds of both."""
    table = Table.grid(padding=(0, 1), expand=True)
    for _ in range(3):
        table.add_column(justify="right")
    upper, lower = panel.wheels
    table.add_row("", Text("upper", style="bold"), Text("lower", style="bold"))
    table.add_row("counts", f"{upper.counts}", f"{lower.counts}")
    table.add_row("turns", f"{upper.turns:.3f}", f"{lower.turns:.3f}")
    table.add_row("rad/s", f"{upper.speed_rad_s:.1f}", f"{lower.speed_rad_s:.1f}")
    table.add_row("rpm", f"{upper.speed_rpm:.0f}", f"{lower.speed_rpm:.0f}")
    return table


def outputs_text(panel: Panel) -> Text:
    """Both sliders, and what the guard currently admits."""
    text = Text(no_wrap=True)
    outputs: tuple[tuple[Output, float], ...] = ("drive", panel.admitted.drive), ("brake", panel.admitted.brake)
    for output, admitted in outputs:
        percent, limit = panel.sliders[output], panel.limits[output]
        full, allowed = (round(_BAR * share / 100) for share in (percent, limit))
        bar = "█" * full + "─" * (allowed - full) + " " * (_BAR - allowed)
        text.append(f"{output} {bar} {percent:3d} %\n", style="" if panel.outputs else "dim")
        text.append(f"   limit {limit} %, output now ")
        text.append(f"{admitted:.0%}\n", style="bold orange1" if admitted else "")
    return text


def board_text(panel: Panel, address: str, introduction: dict[str, str], look: dict[str, Any]) -> Text:
    """Identity of the board, its wiring, settings and flags."""
    config = panel.config
    board = config.board
    text = Text()
    text.append(f"{plain(address)}  {plain(introduction['identity'])}, profile {plain(config.profile)}\n", style="bold")
    because = introduction["read_only_because"]
    if "STILL" in because:
        text.append(f"{plain(because)}\n", style="bold red")
    if look.get("problem"):
        text.append(f"reading the board failed: {plain(look['problem'])}\n", style="bold red")
    flags = panel.flags.name or "none"
    text.append(f"exchange flags now: {flags.lower()}; failed or slow so far: {panel.failed}\n")
    found = panel.pwm(look)
    wanted = f", not the profile's {board.pwm_mode}, {board.pwm_prescaler}"
    pwm = [f"{o.output}: PWM {o.channel}, {o.mode}, prescaler {o.prescaler}{'' if o.fits else wanted}" for o in found]
    text.append(("; " if all(one.fits for one in found) else "\n").join(pwm) + "\n")
    text.append_text(_readings(look.get("readings", [])))
    text.append("PWM settings are changed in the profile: --set board.pwm_prescaler=N\n", style="dim")
    signed = f"signed by {plain(board.verified_by)} on {board.verified_on}" if board.verified_by else "NOT SIGNED"
    text.append(f"{signed}; wiring: {_confirmed(board)}")
    return text


def _confirmed(board: BoardConfig) -> str:
    """Keys that are not confirmed, by their status."""
    open_: dict[str, list[str]] = {}
    for one in unconfirmed(board):
        key, _, status = one.partition(" ")
        open_.setdefault(status.strip("()"), []).append(key)
    return "; ".join(f"{status}: {', '.join(keys)}" for status, keys in open_.items()) or "all confirmed"


def _readings(readings: list[Any]) -> Text:
    if not readings:
        return Text("this board reports no alarms\n", style="dim")
    return Text(
        "; ".join(
            f"{name} {'?' if value is None else f'{value:g}'}{'' if unit == '1' else f' {unit}'}"
            f"{'' if status == 'confirmed' else f' ({status})'}"
            for name, value, unit, status in readings
        )
        + "\n"
    )


def dump_text(look: dict[str, Any]) -> str:
    """Bytes, then decoded fields."""
    if look.get("problem") or "raw" not in look:
        return f"reading the board failed: {plain(look.get('problem', 'not yet'))}"
    fields = "\n".join(f"  {name} = {plain(value)}" for name, value in look["values"].items())
    return f"{hex_dump(bytes.fromhex(look['raw']))}\n\n{fields}"
