"""Sessions as a script or a notebook has them: shown, compared, replayed, exported."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inteco_abs import sessions
from inteco_abs.analysis import Diff, Replay, Tolerance, diff_sessions, replay_recorded, require_sections
from inteco_abs.api.arguments import speaks_of_arguments
from inteco_abs.api.configuration import chosen_settings, is_varied, setting_lines, varied_lines
from inteco_abs.api.controllers import RECORDED, controllers_of, known_controllers, name_of
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.sessions import Export, card_of, export_target

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from inteco_abs.api.what_if import Alternatives
    from inteco_abs.control import Controller


@dataclass(frozen=True, slots=True, repr=False)
class Session(sessions.Session):
    """A recorded session, shown as figure and result card in a notebook, as result card on a terminal."""

    @property
    def card(self) -> dict[str, Any]:
        """The result card, with the keys of `run --json`. Raises AbsError if the session has none."""
        card = card_of(self)
        if card is None:
            raise AbsError(f"{self.path}: has no result card, and no usable configuration to compute one")
        return card

    @speaks_of_arguments()
    def to_pandas(self, table: str = "tick") -> Any:
        """Table `tick`, `truth` or `events` as a pandas DataFrame with `units` and `meanings` in its attrs."""
        return sessions.to_pandas(self, table)

    @speaks_of_arguments()
    def to_polars(self, table: str = "tick") -> Any:
        """Return a table as a polars DataFrame, without units."""
        return sessions.to_polars(self, table)

    @speaks_of_arguments(FILE="others", font_size="font_size_pt", range="range_s")
    def plot(
        self,
        *others: sessions.Session,
        style: str = "plain",
        width: str = "two",
        font: str | None = None,
        font_size_pt: float | None = None,
        title: bool | None = None,
        panels: Sequence[str] = ("speed", "slip", "torque"),
        range_s: tuple[float, float] | None = None,
        envelope: bool = True,
    ) -> Figure:
        """Figure of speeds, slip and torque since braking began, compared with `others`.

        Speeds are in rad/s, torque in N m, time in s. `style` is `plain`, `ieee` or `elsevier`, `width` is `one` or
        `two` columns of its page. `font` is `serif`, `sans` or an installed font, `font_size_pt` in 5..20. `title`
        is by default as the style has it. `range_s` is a part of the time since braking began. With `envelope`,
        torque that chatters is drawn as its range and mean. A notebook shows the figure; `savefig` writes it. Raises
        AbsError if a run never braked, or without matplotlib, and ConfigError for other values, or more sessions than
        there are colours for.
        """
        from inteco_abs.views.figure import figure_of
        from inteco_abs.views.figure_options import FigureOptions

        options = FigureOptions(
            style=style, width=width, font=font, font_size_pt=font_size_pt, title=title, panels=panels,
            range_s=range_s, envelope=envelope,
        )  # fmt: skip
        return figure_of([self, *others], options)

    @speaks_of_arguments(range="range_s", height="height_px")
    def video(
        self,
        out: str | Path,
        *,
        speed: float = 0.25,
        fps: float | None = None,
        range_s: tuple[float, float] | None = None,
        height_px: int | None = None,
    ) -> Path:
        """Write a video (.mp4 or .gif) of both wheels with speeds, slip and torque, and return its path.

        `speed` is times real time, in 1/256..16, `fps` in 1..120, by default 30, in a GIF 20. `range_s` is a part of
        the time since braking began, `height_px` even, in 240..2160. Raises ConfigError, SessionError, or AbsError
        without the extra `video`, for a GIF `figures`.
        """
        from inteco_abs.views.video import VideoOptions, write_video

        path = Path(out)
        write_video(self, path, VideoOptions(speed=speed, fps=fps, range_s=range_s, height_px=height_px))
        return path

    @speaks_of_arguments()
    def replay(
        self,
        controller: str | type[Controller] | None = None,
        *,
        tolerances: Mapping[str, Tolerance] | None = None,
    ) -> Replay:
        """Repeat every decision and compare bit for bit, or within `tolerances` by field of the tick.

        `controller` is your class or file.py:Class if the run used one, or `recorded` for the code that the session
        keeps. A session with a gap is replayed up to it. Warns if the controller is not the run's. Raises SessionError
        if the session cannot be replayed, ConfigError if its controller is not known.
        """
        recorded = self.metadata.get("controller", {})
        controllers, others = controllers_of(self, controller)
        if (name := recorded.get("name", "")) not in controllers and self.attachments.get(sessions.CONTROLLER_SOURCE):
            problem = f"the session was run with the class {name!r}; pass it, or a file that has it, as file.py:{name}"
            raise ConfigError.of("--controller", problem)
        for other in others:
            warnings.warn(other, stacklevel=3)
        return replay_recorded(self, controllers, tolerances)

    @speaks_of_arguments(set="gains", sweep="gains", figure="plot()", duty="duty", torque="torque_nm")
    def what_if(
        self,
        controller: str | type[Controller] | None = None,
        *,
        estimator: str | None = None,
        gains: Mapping[str, float | Sequence[float]] | None = None,
        settings: Mapping[str, Any] | None = None,
        at_s: float | None = None,
        duty: float = 0.01,
        torque_nm: float = 0.1,
        closed_loop: bool = False,
    ) -> Alternatives:
        """Show what another controller, estimator or other gains would have commanded.

        A gain, or a value of `settings` (by dotted key of rig.toml, in controller, estimator or model), may be a list
        of values: all combinations are tried, at most 100. They switch `at_s` seconds after braking began, or begin
        with the first tick. On the logged counts, which do not react; with `closed_loop` the rig's simulation
        continues, too. `duty` (0..1) and `torque_nm` are the largest differences from the log that count as equal.
        `recorded` names the code that the session keeps. Raises ConfigError, SessionError.
        """
        from inteco_abs.api.what_if import alternatives_to, grid_of

        for name, value in (("--duty", duty), ("--torque", torque_nm)):
            if not 0.0 <= value < math.inf:
                raise ConfigError.of(name, f"{value!r}: must be a number of 0 or more")
        recorded = controller == RECORDED
        controllers = controllers_of(self, RECORDED)[0] if recorded else known_controllers(controller)
        named = None if controller is None or recorded else name_of(controller)
        chosen = chosen_settings(settings, gains, named, estimator)
        varied = {key: value for key, value in chosen.items() if is_varied(value)}
        fixed = {key: value for key, value in chosen.items() if key not in varied}
        grid = list(grid_of(setting_lines(fixed), varied_lines(varied)))
        return alternatives_to(self, grid, controllers, at_s, (duty, torque_nm), closed_loop=closed_loop)

    @speaks_of_arguments(only="sections")
    def diff(self, other: sessions.Session, *, sections: Sequence[str] = (), rel: float = 0.0) -> Diff:
        """Return what changed from this session to `other`, in all or some `sections`.

        Sections are outcome, result, signals (from the start of braking on), gains, configuration, software, host and
        rig. Metrics may differ by the share `rel`, 0..1, signals by that share of their peak. Raises ConfigError.
        """
        if not 0.0 <= rel <= 1.0:
            raise ConfigError.of("--rel", f"{rel!r}: must be a number in 0..1")
        require_sections(sections)
        return diff_sessions(self, other, tuple(sections), rel)

    @speaks_of_arguments(FILE="others")
    def report(self, *others: sessions.Session, out: str | Path | None = None) -> Path:
        """Write one HTML page about this session and `others`, and return its path.

        Without `out` (.html) it stands beside the session under its name, or as comparison.html in the current folder.
        Files are never overwritten. Raises ConfigError, SessionError, or AbsError without the extra `report`.
        """
        from inteco_abs.views.report import report_path, write_report

        page = Path(out) if out is not None else report_path([each.path for each in (self, *others)])
        write_report([self, *others], page)
        return page

    @speaks_of_arguments(format="form")
    def export(self, out: str | Path | None = None, *, form: str | None = None) -> Export:
        """Write ticks, states of the simulated rig and events as `csv`, `npz`, `mat` or `parquet`.

        `form` follows from the suffix of `out`, and `out` from the session's name; give one of them. A part of a
        session, as `session[10.0:11.0]`, is exported as such. CSV and Parquet hold one table per file: `out` has the
        ticks, and the others lie beside it. `files` of the result has their paths. Raises ConfigError, SessionError,
        or AbsError without the extra `export`.
        """
        chosen, path = export_target(self.path, form, None if out is None else Path(out))
        return sessions.export_session(self, chosen, path)

    def __repr__(self) -> str:
        card = card_of(self) or {}
        return f"<Session {self.path}: {self.tick_count} ticks, {card.get('outcome', 'cut')}>"

    def __rich__(self) -> RenderableType:
        from inteco_abs.views import render_card

        return render_card(self.card, self.metadata.get("session", {}).get("reason", ""))

    def _repr_html_(self) -> str:
        from inteco_abs.views.figure import svg_of
        from inteco_abs.views.report.facts import result_rows

        cells = "".join(
            f"<tr><td>{escape(row.name)}</td><td style='text-align:right'>{escape(row.values[0])}</td></tr>"
            for row in result_rows([self])
        )
        try:
            picture = svg_of([self]).decode()
        except AbsError as error:  # it never braked, or there is no matplotlib
            picture = f"<p>{escape(str(error))}</p>"
        return f"<p><b>{escape(repr(self))}</b></p>{picture[max(picture.find('<svg'), 0) :]}<table>{cells}</table>"


@speaks_of_arguments()
def open_session(path: str | Path) -> Session:
    """The session at `path`, by its index: ticks are read, and checked, as they are used; `validate` checks all.

    An address such as "https://lab.example/stop.mcap" is read in parts, with the extra `remote`.
    `session[10.0:11.0]` reads one second, `session.blocks()` goes through a long session in little memory. A cut file
    is read as far as it goes, with the reason in `incomplete`. Raises SessionError.
    """
    found = sessions.open_session(sessions.session_path(path))
    return Session(*(getattr(found, each.name) for each in fields(found)))
