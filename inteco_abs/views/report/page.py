"""The report as one HTML page that loads nothing else; only bokeh's script and its own run in it."""

from __future__ import annotations

import base64
import importlib.util
import secrets
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.sessions import Session, check_output, write_file
from inteco_abs.version import __version__
from inteco_abs.views.comparison import held_spans, labels, require_distinct
from inteco_abs.views.figure import svg_of
from inteco_abs.views.report.commands import repeat_commands, replay_commands
from inteco_abs.views.report.facts import fact_tables, result_rows
from inteco_abs.views.report.traces import MARGIN_S, Look, ReportTrace, look_of, traces_of
from inteco_abs.views.report.warnings import outcome_of, warnings_of

SUFFIX: Final = ".html"
if TYPE_CHECKING:
    from inteco_abs.views.report.plots import Drawing

_NEEDED: Final = ("bokeh", "jinja2")


def report_path(files: Sequence[Path]) -> Path:
    """Default page about these sessions: beside one, for several in the current folder."""
    return files[0].with_suffix(SUFFIX) if len(files) == 1 else Path(f"comparison{SUFFIX}")


def check_report(path: Path) -> None:
    """Check that a new report can be written to `path`. Raises ConfigError, SessionError, or AbsError without bokeh."""
    if path.suffix != SUFFIX:
        raise ConfigError.of("--out", f"{path}: must end in {SUFFIX}")
    check_output(path)
    if any(importlib.util.find_spec(name) is None for name in _NEEDED):
        raise AbsError("reports need bokeh: pip install 'inteco-abs[report]'")


def write_report(sessions: Sequence[Session], path: Path) -> None:
    """Write the page about `sessions` to the new file `path`.

    Raises ConfigError for a wrong path, too many sessions or one named twice, SessionError if the page cannot be
    written, AbsError without bokeh.
    """
    check_report(path)
    require_distinct(sessions)
    write_file(path, report_page(sessions).encode())


def report_page(sessions: Sequence[Session]) -> str:
    """The page as text. Without matplotlib it lacks the figure that replaces the plots in print."""
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415  an extra
    from markupsafe import Markup  # noqa: PLC0415  comes with it

    traces = traces_of(sessions)
    panels, scripts = _panels(traces)
    sheet = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    page: str = sheet.from_string(_resource("page.html")).render(
        title=_title(sessions),
        version=__version__,
        sessions=list(map(_facts, map(look_of, range(len(sessions))), sessions, labels(sessions))),
        result=result_rows(sessions),
        tables=fact_tables(sessions),
        span=_span(traces),
        density=[_density(trace, alone=len(sessions) == 1) for trace in traces],
        panels=panels,
        dashes={"solid": "none", "dashed": "6 4", "dotted": "2 3"},
        virtual=any(session.metadata.get("rig", {}).get("virtual_time") == "true" for session in sessions),
        picture=_print_figure(sessions),
        style=Markup(_resource("page.css")),  # noqa: S704  ours
        scripts=[Markup(script) for script in (*scripts, _resource("page.js"))],  # noqa: S704  bokeh's and ours
        nonce=secrets.token_urlsafe(16),
    )
    return page


def _resource(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def _title(sessions: Sequence[Session]) -> str:
    return f"Braking stop {sessions[0].path.name}" if len(sessions) == 1 else f"{len(sessions)} braking stops compared"


def _facts(look: Look, session: Session, label: str) -> dict[str, Any]:
    return {
        "look": look,
        "label": label,
        "path": str(session.path),
        "outcome": outcome_of(session),
        "started": session.metadata.get("session", {}).get("started_utc", "")[:19].replace("T", " "),
        "warnings": warnings_of(session),
        "replay": replay_commands(session),
        "repeat": repeat_commands(session),
    }


def _panels(traces: Sequence[ReportTrace]) -> tuple[list[Drawing], list[str]]:
    """Plots as elements of the page, and the scripts that draw them; empty without traces."""
    if not traces:
        return [], []
    from bokeh.embed import components  # noqa: PLC0415  heavy, and an extra
    from bokeh.resources import Resources  # noqa: PLC0415  likewise
    from markupsafe import Markup  # noqa: PLC0415  likewise

    from inteco_abs.views.report.phase_planes import phase_plane, timing_histogram  # noqa: PLC0415  likewise
    from inteco_abs.views.report.plots import time_plots  # noqa: PLC0415  likewise

    drawn = [*time_plots(traces), phase_plane(traces), timing_histogram(traces)]
    script, elements = components({each.key: each.plot for each in drawn}, wrap_script=False)
    panels = [each._replace(plot=Markup(elements[each.key])) for each in drawn]  # noqa: S704  bokeh's own element
    return panels, [*Resources(mode="inline", components=["bokeh"]).js_raw, script]


def _span(traces: Sequence[ReportTrace]) -> dict[str, tuple[float, float]]:
    """First and last time, s, of braking (`held`) and of the sessions (`whole`)."""
    if not traces:
        return {}
    held, whole = [trace.held_s for trace in traces], [trace.whole_s for trace in traces]
    return {
        name: (min(first for first, _ in spans) - MARGIN_S, max(last for _, last in spans) + MARGIN_S)
        for name, spans in (("held", held), ("whole", whole))
    }


def _density(trace: ReportTrace, *, alone: bool) -> str:
    inside, outside = (
        "every tick" if size == 1 else f"the smallest and the largest of each {size} ticks"
        for size in (trace.points.inside, trace.points.outside)
    )
    text = inside if inside == outside else f"{inside} while the brake was in charge, {outside} elsewhere"
    return text if alone else f"{trace.look.letter}: {text}"


def _print_figure(sessions: Sequence[Session]) -> str:
    """The figure for print as SVG in base64; empty without matplotlib, or if no session braked."""
    braked = [session for session in sessions if held_spans(session)]
    if not braked or importlib.util.find_spec("matplotlib") is None:
        return ""
    return base64.b64encode(svg_of(braked)).decode("ascii")
