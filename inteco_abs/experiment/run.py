"""One run from start to file, in virtual or real time."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from dataclasses import replace

from inteco_abs.config import RigConfig
from inteco_abs.control import Pipeline, build_pipeline, check_changes, gains_to_change
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.experiment.plan import Plan, RunProgress, run_checks
from inteco_abs.experiment.real_time import run_in_real_time
from inteco_abs.experiment.user_code import time_limit
from inteco_abs.experiment.virtual_run import Interrupts, VirtualRun
from inteco_abs.plugins import with_files
from inteco_abs.realtime import NoScreen, SafeScreen, Screen, Tuner, handle_signals
from inteco_abs.sessions import RunResult, check_output


def run_stop(
    config: RigConfig,
    plan: Plan,
    progress: RunProgress | None = None,
    screen: Screen | None = None,
    tuner: Tuner | None = None,
) -> RunResult:
    """Run one experiment and record it at `plan.out`; `screen` shows it, in real time ten times a second.

    In real time `tuner` changes gains while it lasts. SIGINT, SIGTERM and similar signals end it at the next tick, with
    SAFE and a complete file. Raises ConfigError or BoardError if it cannot start, and leaves no file. If SAFE was not
    confirmed, the outcome is `aborted`, with a warning on the screen, or UnsafeError is raised if there is no session.
    """
    check_output(plan.out)
    if tuner is not None and plan.virtual:
        raise ConfigError.of(
            "tuner", "virtual time is over before a person can change a gain: plan it, with experiment.changes"
        )
    for condition in run_checks(config, plan):
        condition()
    # a controller's prints must not mix with the result card
    with redirect_stdout(sys.stderr):
        with time_limit():
            pipeline = build_pipeline(config, plan.controllers)
            gains = gains_to_change(pipeline, config, plan.controllers)
            check_changes(config, gains)
        plan = replace(plan, controller_source=with_files(config.controller.name, plan.controller_source))
        if not plan.virtual:
            if config.loop.compiled:
                _make_machine_code(config, pipeline, screen or NoScreen())
            return run_in_real_time(config, plan, screen or NoScreen(), tuner or Tuner(), gains)
        interrupts, screen = Interrupts(), SafeScreen(screen or NoScreen())
        with handle_signals(interrupts.handle), screen.listening(interrupts.handle):
            return VirtualRun(config, plan, pipeline, interrupts).run(progress, screen)


def _make_machine_code(config: RigConfig, pipeline: Pipeline, screen: Screen) -> None:
    """Keep the machine code of the decisions on disk, if it is not there yet; raises AbsError if it cannot be."""
    from inteco_abs.realtime.compiled_pipeline import CompiledPipeline  # noqa: PLC0415  loads LLVM

    try:
        CompiledPipeline(config, pipeline)
    except AbsError:
        screen.note("making machine code of the decisions, once: this takes up to 12 s")
        CompiledPipeline(config, pipeline, may_make=True)
