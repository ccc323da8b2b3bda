"""Interface for notebooks and scripts, offered by `import inteco_abs`: connect to a board, run stops, open sessions."""

from __future__ import annotations

import inspect
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsFloat

from inteco_abs import analysis, sessions
from inteco_abs.boards import check_address, check_kind, default_profile, kind_check, simulated
from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import Controller, build_pipeline, control_check, preferred_estimator
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.experiment import Plan, replay_problem
from inteco_abs.experiment import run_stop as run_experiment
from inteco_abs.mock_board import rig_check
from inteco_abs.plugins import FROM_FILE, Controllers, Origin, load_controller
from inteco_abs.population_file import rig_settings
from inteco_abs.realtime import Tuner
from inteco_abs.sessions import card_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


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

    def to_pandas(self, table: str = "tick") -> Any:
        """Table `tick`, `truth` or `events` as a pandas DataFrame with `units` and `meanings` in its attrs."""
        return sessions.to_pandas(self, table)

    def to_polars(self, table: str = "tick") -> Any:
        """Return a table as a polars DataFrame, without units."""
        return sessions.to_polars(self, table)

    def plot(self, *others: sessions.Session, width: str = "two") -> Figure:
        """Figure of speeds, slip and torque since braking began, compared with `others`.

        `width` is `one` or `two` columns of a journal. Raises AbsError if a run never braked, or without matplotlib.
        """
        from inteco_abs.views.figure import figure_of  # noqa: PLC0415  heavy, and an extra

        return figure_of([self, *others], width)

    def replay(self, controller: type[Controller] | None = None) -> analysis.Replay:
        """Repeat every decision and compare bit for bit; `controller` is your class if the run used one.

        Raises SessionError if the session cannot be replayed.
        """
        known = _known(controller or self.metadata.get("controller", {}).get("name", ""))
        config = sessions.session_config(self, (control_check(known),))
        with analysis.recorded_arithmetic(self):
            return analysis.replay_session(self, build_pipeline(config, known))

    def __repr__(self) -> str:
        card = card_of(self) or {}
        return f"<Session {self.path}: {len(self.ticks)} ticks, {card.get('outcome', 'cut')}>"

    def __rich__(self) -> RenderableType:
        from inteco_abs.views import render_card  # noqa: PLC0415  only for a terminal

        return render_card(self.card, self.metadata.get("session", {}).get("reason", ""))

    def _repr_html_(self) -> str:
        from inteco_abs.views.figure import svg_of  # noqa: PLC0415  heavy, and an extra
        from inteco_abs.views.report.facts import result_rows  # noqa: PLC0415  only for a notebook

        cells = "".join(
            f"<tr><td>{escape(row.name)}</td><td style='text-align:right'>{escape(row.values[0])}</td></tr>"
            for row in result_rows([self])
        )
        try:
            picture = svg_of([self]).decode()
        except AbsError as error:  # it never braked, or there is no matplotlib
            picture = f"<p>{escape(str(error))}</p>"
        return f"<p><b>{escape(repr(self))}</b></p>{picture[max(picture.find('<svg'), 0) :]}<table>{cells}</table>"


@dataclass(frozen=True, slots=True)
class Rig:
    """A board with the rig, and the settings of its runs."""

    board: str
    """Address, as for `run --board`."""
    config_file: Path | None = None
    """A rig.toml; without one, the defaults of the board's profile hold."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Values by dotted key of rig.toml, as {"guard.brake_limit": 0.6}."""

    def config(self, controller: str | type[Controller] | None = None, **settings: Any) -> RigConfig:
        """Effective configuration of a run with that controller. Raises ConfigError."""
        known = _known(controller)
        name = {} if controller is None else {"controller.name": _name(controller)}
        # TOML writes numbers, text, booleans and lists as JSON does
        lines = [f"{key}={json.dumps(value)}" for key, value in {**self.settings, **settings, **name}.items()]
        checks = [control_check(known), kind_check, rig_check]
        return load_config(self.config_file, lines, checks, default_profile(self.board), preferred_estimator(known))

    def run_stop(
        self,
        controller: str | type[Controller] | None = None,
        *,
        estimator: str | None = None,
        gains: Mapping[str, float] | None = None,
        settings: Mapping[str, Any] | None = None,
        out: str | Path | None = None,
        seed: int = 0,
        real_time: bool | None = None,
        changes: Sequence[str] = (),
        tuner: Tuner | None = None,
    ) -> Session:
        """Drive, brake and record; return the session. `card["outcome"]` has the outcome.

        `controller` is a name as on the command line or, in virtual time, a class; `seed` is that of the mock board's
        random state. A simulated board runs in virtual time unless `real_time` is True. `changes` plans changes of
        gains, as "Mk=5@brake+200ms"; in real time `tuner` makes them while the run lasts. An interrupt ends the run
        safely. Warns if the decisions of a controller that does not ship do not replay. Raises ConfigError or
        BoardError if it cannot start.
        """
        chosen: dict[str, Any] = dict(settings or {})
        given: Mapping[str, object] = gains or {}
        for name, value in given.items():  # also numpy's numbers; the configuration checks the type
            chosen[f"controller.gains.{name}"] = float(value) if isinstance(value, SupportsFloat) else value
        if changes:
            chosen["experiment.changes"] = list(changes)
        if estimator is not None:
            chosen["estimator.name"] = estimator
        config = self.config(controller, **chosen)
        known = _known(controller)
        origin = known.origin(config.controller.name)
        path = Path(out) if out is not None else _default_out()
        virtual = simulated(self.board) if real_time is None else not real_time
        if isinstance(controller, type) and not virtual:
            problem = f"{_name(controller)} is a class of this process; real time needs a file: file.py:Class"
            raise ConfigError.of("controller", problem)
        plan = Plan(path, self.board, virtual, seed, known, origin.source, controller_package=origin.package)
        problem = replay_problem(config, plan, run_experiment(config, plan, tuner=tuner))
        if problem:
            warnings.warn(problem, stacklevel=2)
        return open_session(path)


def connect(
    board: str = "sim:",
    *,
    rig: str | None = None,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Rig:
    """The board at an address as for `run --board`.

    With the mock board, `rig` is a sampled rig such as "hard:17" or "my-lab.toml:17". Nothing is opened before a run.
    Raises ConfigError or BoardError for a wrong address, file or setting.
    """
    check_address(board)
    drawn = rig_settings(rig, "rig")
    found = Rig(board, None if config is None else Path(config), {**(settings or {}), **drawn})
    check_kind(board, found.config())
    return found


def run_stop(board: str = "sim:", controller: str | type[Controller] | None = None, **choices: Any) -> Session:
    """One stop with the defaults of `connect`; `choices` are those of `Rig.run_stop`."""
    return connect(board).run_stop(controller, **choices)


def open_session(path: str | Path) -> Session:
    """The session at `path`, by its index: ticks are read, and checked, as they are used; `validate` checks all.

    An address such as "https://lab.example/stop.mcap" is read in parts, with the extra `remote`.
    `session[10.0:11.0]` reads one second, `session.blocks()` goes through a long session in little memory. A cut file
    is read as far as it goes, with the reason in `incomplete`. Raises SessionError.
    """
    found = sessions.open_session(sessions.session_path(path))
    return Session(*(getattr(found, each.name) for each in fields(found)))


def _known(controller: str | type[Controller] | None) -> Controllers:
    if isinstance(controller, type):
        return Controllers({_name(controller): (controller, Origin(_source(controller)))})
    if controller is None or FROM_FILE not in controller:
        return Controllers()
    kind, source = load_controller(controller)
    return Controllers({controller: (kind, Origin(source))})


def _name(controller: str | type[Controller]) -> str:
    return controller if isinstance(controller, str) else controller.__name__


def _source(controller: type[Controller]) -> bytes:
    """Source of the class, for the session; empty if it cannot be found, as at a prompt."""
    try:
        return inspect.getsource(controller).encode()
    except (OSError, TypeError):
        return b""


def _default_out() -> Path:
    folder = Path("sessions")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise AbsError(f"the folder {folder} cannot be made here ({error.strerror}); name a file with out=") from error
    return folder / f"stop-{datetime.now().astimezone():%Y%m%d-%H%M%S-%f}.mcap"
