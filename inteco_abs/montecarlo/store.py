"""The folder of a sweep: its description, and one Parquet file for each unit that was braked.

A file is written aside and renamed into place, and its content depends on the description and the unit alone. So it
does not matter who writes it, how often, or who was killed meanwhile.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from inteco_abs.errors import AbsError, ConfigError, describe_disk
from inteco_abs.montecarlo.grid import Combination
from inteco_abs.montecarlo.plan import SweepPlan, Unit
from inteco_abs.montecarlo.results import METRICS, ResultSummary, StopResults, summarize
from inteco_abs.montecarlo.samples import SampleSet
from inteco_abs.quantities import finite
from inteco_abs.sessions import atomic_write

if TYPE_CHECKING:
    from pyarrow import Table

_PLAN: Final = "sweep.json"
_MOST_VALUES: Final = 10_000_000
"""Read at once, if one metric has no more: 80 MB."""
_SWEEP: Final = "inteco_abs.sweep"
"""Metadata of a part: the description's hash."""
_LEFT_OUT: Final = "inteco_abs.left_out"
"""Seeds of rigs that do not count, as JSON."""
_TICKS: Final = "inteco_abs.ticks"
"""Number of decisions."""
_END: Final = b"PAR1"
"""The last bytes of a Parquet file."""
_STALE_S: Final = 86_400.0
"""Age at which no process writes an unfinished file any more: that takes seconds, and clocks of computers differ."""


class SweepFolder:
    """A sweep on disk."""

    def __init__(self, path: Path, plan: SweepPlan) -> None:
        self.path = path
        self.plan = plan

    @staticmethod
    def make(path: Path, plan: SweepPlan, option: str = "--store") -> SweepFolder:
        """The folder of this plan, new or as it was left. Raises ConfigError if it has another plan, or AbsError."""
        file = path / _PLAN
        try:
            for folder in ("part", "failed"):
                (path / folder).mkdir(parents=True, exist_ok=True)
            if not file.exists():
                with atomic_write(file) as part, part.open("w", encoding="utf-8", newline="\n") as stream:
                    stream.write(plan.to_json())
                    stream.flush()
                    os.fsync(stream.fileno())
        except OSError as error:
            raise AbsError(f"{path}: the sweep cannot be stored there: {describe_disk(error)}") from error
        if (found := _stored_name(file)) != plan.name:
            problem = f"has the sweep {found[:12]}, and this is {plan.name[:12]}: other settings, rigs or program"
            raise ConfigError.of(option, f"{path} {problem}; name another folder, or continue that one with --work")
        return SweepFolder(path, plan)

    @staticmethod
    def open(path: Path, option: str = "--work") -> SweepFolder:
        """A folder that exists. Raises ConfigError if it has no plan, or that of another program."""
        file = path / _PLAN
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else "not text"
            raise ConfigError.of(option, f"{path}: not the folder of a sweep: {_PLAN}: {why}") from error
        return SweepFolder(path, SweepPlan.from_json(text, str(file), option))

    def part(self, unit: Unit) -> Path:
        """The file of a unit, which exists if the unit was braked."""
        return self.path / "part" / f"{unit.name}.parquet"

    def has(self, unit: Unit) -> bool:
        """Whether the file of a unit is there with its end; one that is empty or cut short is braked again."""
        try:
            with self.part(unit).open("rb") as file:
                file.seek(-len(_END), os.SEEK_END)
                return file.read() == _END
        except OSError:  # missing, too short or not readable: another takes its place
            return False

    def remove_stale(self) -> None:
        """Remove what processes that were killed left unfinished, a day ago or more."""
        for file in (*self.path.glob("*.part"), *self.path.glob("*/*.part")):
            with suppress(OSError):  # another process removes it, too
                if time.time() - file.stat().st_mtime > _STALE_S:
                    file.unlink()

    def write(self, unit: Unit, draws: SampleSet, stops: StopResults) -> None:
        """Store the results of a unit. Raises AbsError if the disk fails."""
        from pyarrow import parquet  # noqa: PLC0415  heavy

        table = self._table(unit, stops, draws.seeds)
        facts = {_SWEEP: self.plan.name, _LEFT_OUT: json.dumps(draws.left_out), _TICKS: str(stops.ticks)}
        words = [name for name, kind in zip(table.column_names, table.schema.types, strict=True) if kind == "string"]
        # without statistics and Arrow's schema the end of the file is half as long, which is most of a small one
        options = {
            "use_dictionary": words,
            "write_statistics": False,
            "store_schema": False,
            "write_page_checksum": True,
        }
        try:
            with atomic_write(self.part(unit)) as path, path.open("xb") as file:
                with parquet.ParquetWriter(file, table.schema, compression="zstd", **options) as writer:
                    writer.add_key_value_metadata(facts)
                    writer.write_table(table)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise AbsError(f"{self.part(unit)}: cannot be written: {describe_disk(error)}") from error
        with suppress(OSError):
            self._failure(unit).unlink()

    def _table(self, unit: Unit, stops: StopResults, seeds: Sequence[int]) -> Table:
        import pyarrow as pa  # noqa: PLC0415  heavy

        combination = self.plan.grid[unit.combination]
        words = {
            "population": unit.population,
            "controller": combination.config.controller.name,
            "estimator": combination.config.estimator.name,
            **{key: combination.varied.get(key) for one in self.plan.grid for key in one.varied},
        }
        columns = {"seed": pa.array(seeds, pa.uint64())}
        columns |= {name: pa.array([word] * len(stops), pa.string()) for name, word in words.items()}
        columns |= {name: pa.array(stops[name], pa.float64(), from_pandas=True) for name in METRICS}
        columns["error"] = pa.array([error or None for error in stops.errors], pa.string())
        return pa.table(columns)

    def fail(self, unit: Unit, problem: str) -> None:
        """List a unit that is given up."""
        text = json.dumps({**unit._asdict(), "problem": problem})
        with suppress(OSError), atomic_write(self._failure(unit)) as path:
            path.write_text(text, encoding="utf-8", newline="\n")

    def failures(self) -> dict[str, str]:
        """Why units were given up that are still missing, by name. Raises AbsError for a damaged record."""
        problems = {}
        for file in sorted((self.path / "failed").glob("*.json")):
            try:
                one = json.loads(file.read_text(encoding="utf-8"))
                unit, problem = Unit(*(one[key] for key in Unit._fields)), one["problem"]
            except FileNotFoundError:  # another process has just braked it
                continue
            except (OSError, ValueError, LookupError, TypeError) as error:
                raise AbsError(f"{file}: not readable; remove it: {error}") from error
            if not self.has(unit):
                problems[unit.name] = problem
        return problems

    def _failure(self, unit: Unit) -> Path:
        return self.path / "failed" / f"{unit.name}.json"

    def rows(self) -> list[SweepRow]:
        """A row for each configuration and range of draws of which something was braked or left out."""
        rows = [SweepRow(self, draws, number) for draws, number in self.plan.rows()]
        return [row for row in rows if row.stops or row.left_out]


def _stored_name(file: Path) -> str:
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["sha256"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigError.of("--store", f"{file}: is not the description of a sweep; name another folder") from error


class SweepRow:
    """One configuration on one range of draws, as far as it was braked; a column is read when it is asked for."""

    def __init__(self, folder: SweepFolder, draws: SampleSet, combination: int) -> None:
        self.draws = draws
        self.combination: Combination = folder.plan.grid[combination]
        units = folder.plan.units_of(draws, combination)
        self._parts = [path for unit in units if (path := folder.part(unit)).exists()]
        self._name = folder.plan.name.encode()

    @cached_property
    def _facts(self) -> tuple[int, list[int]]:
        """Number of stops, and seeds of rigs that are left out."""
        stops, left_out = 0, list[int]()
        for metadata in self._each(lambda file: file.metadata):
            stops += metadata.num_rows
            left_out += json.loads(metadata.metadata[_LEFT_OUT.encode()])
        return stops, left_out

    @property
    def stops(self) -> int:
        """Number of stops."""
        return self._facts[0]

    @property
    def left_out(self) -> list[int]:
        """Seeds as of `SampleSet.left_out`."""
        return self._facts[1]

    @property
    def ticks(self) -> int:
        """Number of decisions in all stops."""
        return sum(int(metadata.metadata[_TICKS.encode()]) for metadata in self._each(lambda file: file.metadata))

    def __getitem__(self, metric: str) -> NDArray[np.float64]:
        """One metric of all stops; NaN for a stop that does not have it."""
        ((_, values),) = self._columns([metric])
        return values

    @cached_property
    def seeds(self) -> NDArray[np.uint64]:
        """Of the rigs that were braked."""
        ((_, values),) = self._columns(["seed"])
        return values

    def errors(self) -> Iterator[tuple[int, str]]:
        """Seed and error of each stop that ended early."""
        for table in self._each(lambda file: file.read(["seed", "error"])):
            if table["error"].null_count < len(table):
                pairs = zip(table["seed"].to_pylist(), table["error"].to_pylist(), strict=True)
                yield from ((seed, error) for seed, error in pairs if error)

    @cached_property
    def summary(self) -> ResultSummary:
        """Distribution of the metrics, and shares of stops that failed."""
        size = max(1, _MOST_VALUES // self.stops)
        groups = (METRICS[first : first + size] for first in range(0, len(METRICS), size))
        columns = (column for names in groups for column in self._columns(names))
        return summarize(columns, sum(1 for _ in self.errors()))

    def _columns(self, names: Sequence[str]) -> Iterator[tuple[str, NDArray[Any]]]:
        tables = list(self._each(lambda file: file.read(list(names))))
        for name in names:
            yield name, np.concatenate([table[name].to_numpy() for table in tables])

    def _each(self, read: Callable[[Any], Any]) -> Iterator[Any]:
        """What `read` finds in each part. Raises AbsError for one that is not readable, or another sweep's."""
        from pyarrow import ArrowException, parquet  # noqa: PLC0415  heavy

        for path in self._parts:
            try:
                with parquet.ParquetFile(path, page_checksum_verification=True) as file:
                    if (file.metadata.metadata or {}).get(_SWEEP.encode()) != self._name:
                        raise AbsError(f"{path}: belongs to another sweep; remove it, and continue with --work")
                    found = read(file)
            except (OSError, ArrowException) as error:
                raise AbsError(f"{path}: not readable; remove it, and continue with --work: {error}") from error
            yield found

    def facts(self) -> dict[str, Any]:
        """As JSON has it: None for what is infinite, because a stop has no such thing."""
        summary, config = self.summary, self.combination.config
        metrics = {
            name: {
                "median": finite(spread.median),
                "p99": finite(spread.p99),
                "max": finite(spread.largest),
                "worst_seed": self.seeds.item(spread.worst),
                "median_interval_90": list(map(finite, spread.median_interval)),
                "p99_interval_90": list(map(finite, spread.p99_interval)),
            }
            for name, spread in summary.spreads.items()
        }
        return {
            "rigs": self.draws.name,
            "left_out": self.left_out,
            "controller": config.controller.name,
            "estimator": config.estimator.name,
            "settings": dict(self.combination.varied),
            "stops": summary.stops,
            "failed": summary.failed,
            "locked_share": summary.locked,
            "never_in_band_share": summary.never_entered,
            "fell_back_share": summary.fell_back,
            "metrics": metrics,
        }

    @property
    def columns(self) -> tuple[str, ...]:
        """Keys of each record."""
        return ("population", "seed", "controller", "estimator", *self.combination.varied, *METRICS, "error")

    def records(self) -> Iterator[dict[str, Any]]:
        """One for each stop; None where it has no such metric."""
        for table in self._each(lambda file: file.read(list(self.columns))):
            for record in table.to_pylist():
                yield record | {"error": record["error"] or ""}
