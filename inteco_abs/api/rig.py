"""A board with the rig, and its runs."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inteco_abs.api.arguments import speaks_of_arguments
from inteco_abs.api.configuration import as_list, chosen_settings, require_whole, run_config, setting_lines
from inteco_abs.api.controllers import known_controllers, name_of
from inteco_abs.api.session import Session, open_session
from inteco_abs.boards import check_kind, simulated
from inteco_abs.control import control_check, preferred_estimator
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.experiment import Plan, replay_problem
from inteco_abs.experiment import run_stop as run_experiment
from inteco_abs.mock_board import parse_faults
from inteco_abs.sessions import check_session_file, ensured_directory

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.control import Controller
    from inteco_abs.realtime import Tuner


@dataclass(frozen=True, slots=True)
class Rig:
    """A board with the rig, and the settings of its runs; `connect` makes one."""

    board: str = "sim:"
    """Address, as for `run --board`."""
    config_file: Path | None = None
    """A rig.toml; without one, the defaults of the board's profile hold."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Values by dotted key of rig.toml, as {"guard.brake_limit": 0.6}."""
    rig: str | None = None
    """With the mock board, the sampled rig, as "hard:17"."""

    @speaks_of_arguments(config="config_file")
    def config(self, controller: str | type[Controller] | None = None, **settings: Any) -> RigConfig:
        """Effective configuration of a run with that controller; `settings` are by dotted key. Raises ConfigError."""
        known = known_controllers(controller)
        name = None if controller is None else name_of(controller)
        own, more = (setting_lines(each) for each in (self.settings, chosen_settings(settings, None, name)))
        checks, follows = [control_check(known)], preferred_estimator(known)
        return run_config(self.board, self.config_file, own, self.rig, checks, follows, more)

    @speaks_of_arguments(set="settings", virtual="real_time", inject="faults", change="changes")
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
        faults: Sequence[str] = (),
        changes: Sequence[str] = (),
        tuner: Tuner | None = None,
    ) -> Session:
        """Drive, brake and record; return the session. `card["outcome"]` has the outcome.

        `controller` and `estimator` are names as on the command line, "file.py:Class", or for the controller, in
        virtual time, a class; `gains` are the controller's, in its units. `out` (.mcap) is by default a new file in the
        folder sessions. `seed`, of 0 or more, is that of the mock board's random state, and `faults` are injected into
        it, as "lose@brake+20ms". A simulated board runs in virtual time unless `real_time` is True. `changes` plans
        changes of gains, as "Mk=5@brake+200ms"; in real time `tuner` makes them while the run lasts. An interrupt ends
        the run safely. Warns if the decisions of a controller that does not ship do not replay. Raises ConfigError or
        BoardError if it cannot start.
        """
        chosen = chosen_settings(settings, gains, None, estimator)
        if changes:
            chosen["experiment.changes"] = as_list(changes)
        config = self.config(controller, **chosen)
        known = known_controllers(controller)
        origin = known.origin(config.controller.name)
        virtual = simulated(self.board) if real_time is None else not real_time
        if isinstance(controller, type) and not virtual:
            problem = f"{name_of(controller)} is a class of this process; real time needs a file: file.py:Class"
            raise ConfigError.of("--controller", problem)
        require_whole("--seed", seed, 0, (1 << 64) - 1)
        path = Path(out) if out is not None else _default_out()
        check_session_file(path)
        plan = Plan(
            path, self.board, virtual, seed, known, origin.source, controller_package=origin.package,
            faults=parse_faults(as_list(faults)),
        )  # fmt: skip
        problem = replay_problem(config, plan, run_experiment(config, plan, tuner=tuner))
        if problem:
            warnings.warn(problem, stacklevel=3)
        return open_session(path)

    @speaks_of_arguments(out="folder", plan="record_for_identification()")
    def record_for_identification(
        self,
        folder: str | Path = "identification",
        *,
        after: Sequence[Session | str | Path] = (),
        pause_s: float = 10.0,
        real_time: bool | None = None,
    ) -> list[Session]:
        """Record the runs from which `identify` finds this rig's parameters, one after another, into `folder`.

        `after` are sessions that are there: then it records those, at most three, that make their intervals
        narrowest. In real time it waits `pause_s` between two runs, to cool the motors; on a simulated board it runs
        in virtual time unless `real_time` is True. Raises AbsError for a run that does not complete, ConfigError.
        """
        from inteco_abs.api.identify import identified, next_planned_runs, planned_run

        virtual = simulated(self.board) if real_time is None else not real_time
        rig = self.config()
        found = identified(rig, after) if after else None
        place, recorded = Path(folder), list[Session]()
        own = partial(run_config, self.board, self.config_file, setting_lines(self.settings), self.rig)
        with ensured_directory(place):
            for number, run in enumerate(next_planned_runs(rig, found), len(after)):
                config, plan = planned_run(run, own, place, self.board, virtual=virtual, seed=number)
                if recorded and not virtual:
                    time.sleep(pause_s)
                stop = run_experiment(config, plan)
                if stop.outcome != "completed":
                    raise AbsError(f"{plan.out}: {stop.outcome}: {stop.explanation}")
                recorded.append(open_session(plan.out))
        return recorded


@speaks_of_arguments()
def connect(
    board: str = "sim:",
    *,
    rig: str | None = None,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Rig:
    """The board at an address as for `run --board`; "sim:" is the mock board with a simulated rig.

    With the mock board, `rig` is a sampled rig such as "hard:17" or "my-lab.toml:17". `config` is a rig.toml, and
    `settings` are values by dotted key over it, in the units of rig.toml. Nothing is opened before a run. Raises
    ConfigError or BoardError for a wrong address, file or setting.
    """
    found = Rig(board, None if config is None else Path(config), dict(settings or {}), rig)
    check_kind(board, found.config())
    return found


@speaks_of_arguments(set="settings", virtual="real_time", inject="faults", change="changes")
def run_stop(
    board: str = "sim:",
    controller: str | type[Controller] | None = None,
    *,
    estimator: str | None = None,
    gains: Mapping[str, float] | None = None,
    settings: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    real_time: bool | None = None,
    faults: Sequence[str] = (),
    changes: Sequence[str] = (),
    tuner: Tuner | None = None,
) -> Session:
    """One stop with the defaults of `connect`; the arguments are those of `Rig.run_stop`."""
    return connect(board).run_stop(
        controller,
        estimator=estimator,
        gains=gains,
        settings=settings,
        out=out,
        seed=seed,
        real_time=real_time,
        faults=faults,
        changes=changes,
        tuner=tuner,
    )


def _default_out() -> Path:
    folder = Path("sessions")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise AbsError(f"the folder {folder} cannot be made here ({error.strerror}); name a file with out=") from error
    return folder / f"stop-{datetime.now().astimezone():%Y%m%d-%H%M%S-%f}.mcap"
