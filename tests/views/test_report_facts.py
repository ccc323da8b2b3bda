"""What the report says beside its plots: results, what a session was run with, warnings, commands."""

import shlex
from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.sessions import read_session, recover_session
from inteco_abs.sessions.content import LogEntry
from inteco_abs.signals import BoardFlags, Phase
from inteco_abs.views.report.commands import repeat_commands, replay_commands
from inteco_abs.views.report.facts import fact_tables, result_rows
from inteco_abs.views.report.traces import traces_of
from inteco_abs.views.report.warnings import outcome_of, warnings_of


def with_ticks(session, **columns):
    """The session with a value in a column from a row on."""
    ticks = session.ticks.copy()
    for name, (row, value) in columns.items():
        ticks[name][row:] = value
    return session.with_rows(ticks)


def without_ticks(session):
    return session.with_rows(session.ticks[:0], session.truth[:0])


@pytest.fixture
def clean(session, with_facts):
    return with_facts(session, "software", git_dirty="false")


class TestResult:
    def test_every_metric_has_its_unit(self, session, stop):
        card, rows = stop[0].card, {row.name: row.values for row in result_rows([session])}
        assert rows["stop time"] == (f"{card['stop_time_s']:.3f} s",)
        assert rows["stop distance"] == (f"{card['stop_distance_m']:.2f} m",)
        assert rows["ticks"] == (str(card["ticks"]),)
        assert rows["late, p99"] == ("0.0 us",)

    def test_what_differs_is_marked(self, session, others):
        rows = {row.name: row for row in result_rows([session, *others])}
        assert rows["slip RMS, from 0.25 s"].differs
        assert not rows["overruns"].differs

    @pytest.mark.parametrize("card", ['{"stop_time_s": "soon", "lateness_us": 3, "overruns": null}', "[]", "{"])
    def test_an_invalid_card_has_dashes(self, session, with_facts, card):
        bare = replace(with_facts(session, "result", card=card), attachments={})
        rows = {row.name: row.values for row in result_rows([bare])}
        assert rows["stop time"] == rows["overruns"] == rows["late, most"] == ("–",)


class TestTables:
    def test_gains_configuration_software_host_and_hash(self, session):
        found = {facts.title: {row.name: row.values[0] for row in facts.rows} for facts in fact_tables([session])}
        assert found["controller and gains"]["Mk"] == "2.0"
        assert found["configuration"]["guard.brake_limit"] == "1.0"
        assert found["integrity"]["payload_sha256"] == session.metadata["integrity"]["payload_sha256"]
        assert found["software"].keys() == session.metadata["software"].keys()
        assert found["host"].keys() == session.metadata["host"].keys()

    def test_sessions_stand_beside_one_another(self, session, others):
        (gains, *_) = fact_tables([session, *others])
        rows = {row.name: row for row in gains.rows}
        assert rows["Mk"].values == ("2.0", "10.0", "–")
        assert rows["Mk"].differs
        assert not rows["estimator"].differs

    def test_a_session_without_records_has_no_facts(self, session):
        assert fact_tables([replace(session, metadata={}, attachments={})]) == []


class TestWarnings:
    def test_a_normal_stop_has_no_warnings(self, clean):
        assert warnings_of(clean) == []

    def test_how_and_why_the_guard_ended_it(self, faulty, with_facts):
        row = int(np.flatnonzero(faulty.ticks["reason"])[0])
        end, guard = warnings_of(with_facts(faulty, "software", git_dirty="false"))
        assert end.startswith("Outcome: fault: the road wheel did not stop in time")
        assert guard.startswith(f"The outputs were taken away at tick {row} (")
        assert guard.endswith("in the phase braking: BRAKING_TIMEOUT.")

    def test_a_reason_that_no_card_explains_is_explained(self, faulty):
        silent = replace(faulty, metadata={}, attachments={}, log=())
        assert any("BRAKING_TIMEOUT, the road wheel did not stop in time" in words for words in warnings_of(silent))

    @pytest.mark.parametrize(
        ("columns", "words"),
        [
            ({"skipped": (-3, 2)}, "6 periods were overrun, 4 of them while the brake was in charge."),
            ({"board_flags": (-2, BoardFlags.STALE)}, "2 exchanges with the board failed"),
            ({"board_flags": (-4, BoardFlags.SLOW)}, "4 exchanges with the board took longer than a period."),
        ],
    )
    def test_trouble_in_the_ticks(self, clean, columns, words):
        (found,) = warnings_of(with_ticks(clean, **columns))
        assert found.startswith(words)

    @pytest.mark.parametrize(
        ("record", "facts", "words"),
        [
            ("software", {"git_dirty": "true", "git_commit": "abc"}, "Dirty tree: the program had changes that commit"),
            ("doctor", {"clock": "red: jiffies"}, "The doctor found the computer unfit: clock (jiffies)."),
            ("session", {"outcome": "aborted"}, "Outcome: aborted"),
            ("result", {"card": '{"lost_ticks": 3}'}, "3 ticks were decided and are not in the file."),
        ],
    )
    def test_trouble_in_the_records(self, clean, with_facts, record, facts, words):
        (found,) = warnings_of(with_facts(clean, record, **facts))
        assert found.startswith(words)

    def test_warnings_of_the_log_but_not_those_that_are_reported_already(self, clean, faulty):
        log = (LogEntry(0, 2, "all is well"), *(LogEntry(0, 3, f"trouble {number}") for number in range(12)))
        found = warnings_of(replace(clean, log=log))
        assert found[0] == "Log: trouble 0."
        assert found[-1] == "Log: 2 more."
        assert len(found) == 11
        assert not any(words.startswith("Log") for words in warnings_of(faulty))

    def test_a_file_that_was_cut(self, clean):
        cut = replace(clean, incomplete="it ends")
        assert warnings_of(cut)[0].startswith("The file is incomplete: it ends.")

    def test_a_recovered_session(self, session, tmp_path):
        data = session.path.read_bytes()
        (tmp_path / "cut.mcap").write_bytes(data[: 3 * len(data) // 4])
        recover_session(tmp_path / "cut.mcap", tmp_path / "new.mcap")
        found = warnings_of(read_session(tmp_path / "new.mcap"))
        assert found[0].startswith("Outcome: recovered: recovered from cut.mcap")
        assert not any(words.startswith("Recovered, with losses") for words in found)

    def test_losses_that_the_card_lacks(self, clean, with_facts):
        assert "Recovered, with losses: a tick." in warnings_of(with_facts(clean, "recovery", lost="a tick"))

    def test_no_braking_and_no_ticks(self, clean):
        early = clean.with_rows(clean.ticks[:10])
        assert warnings_of(early) == ["The run ended before braking: times count from its first tick."]
        assert warnings_of(without_ticks(clean)) == ["The session holds no ticks: there is nothing to draw."]

    def test_an_outcome_that_was_not_recorded(self, session):
        silent = replace(session, metadata={})
        assert outcome_of(silent) == "not recorded"
        assert outcome_of(replace(silent, incomplete="cut")) == "not known"


class TestCommands:
    def test_they_replay_and_repeat_the_run_to_the_last_bit(self, session, verb, tmp_path):
        commands = [*replay_commands(session), *repeat_commands(session)]
        assert [shlex.split(line)[1] for line in commands] == ["replay", "extract", "run"]
        for line in commands:
            assert verb(*shlex.split(line)[1:]).code == 0
        assert read_session(tmp_path / "again.mcap").payload == session.payload

    def test_a_users_controller_is_extracted_first(self, session, with_facts):
        mine = with_facts(session, "controller", name="my laws/law.py:Law")
        mine = replace(mine, attachments={**session.attachments, "controller.py": b"class Law: pass"})
        take = f"inteco-abs extract {session.path} controller.py -o law.py"
        assert replay_commands(mine) == [take, f"inteco-abs replay {session.path} --controller law.py:Law"]
        assert take in repeat_commands(mine)
        assert "--controller law.py:Law" in repeat_commands(mine)[-1]

    def test_a_real_board_gets_no_seed(self, session, with_facts):
        real = with_facts(session, "rig", board="usb2:7", simulated="false", virtual_time="false")
        assert repeat_commands(real)[-1] == "inteco-abs run --board usb2:7 --config rig.toml --out again.mcap"

    def test_names_are_quoted_for_the_shell(self, session, tmp_path):
        odd = replace(session, path=tmp_path / "my stop; rm *.mcap")
        (line,) = replay_commands(odd)
        assert shlex.split(line) == ["inteco-abs", "replay", str(odd.path)]

    def test_no_commands_without_configuration_board_or_ticks(self, session, with_facts):
        bare = replace(session, attachments={})
        assert replay_commands(bare) == repeat_commands(bare) == []
        assert replay_commands(without_ticks(session)) == []
        assert repeat_commands(with_facts(session, "rig", board="")) == []


class TestCourses:
    def test_a_real_rig_has_no_truth(self, session):
        (simulated,) = traces_of([session])
        (real,) = traces_of([session.with_rows(truth=session.truth[:0])])
        assert simulated.points.columns.keys() - real.points.columns.keys() == {"true_slip", "true_brake_torque_nm"}

    def test_true_values_are_those_at_the_ticks(self, session):
        (trace,) = traces_of([session])
        true = trace.points.columns["true_slip"][:-1]
        np.testing.assert_array_equal(true, session.truth["slip"][: len(true)].astype(np.float32))

    def test_it_is_about_the_first_stop(self, session):
        (trace,) = traces_of([session])
        assert trace.held_s[0] == 0.0
        again = np.concatenate([session.ticks, session.ticks])
        again["time_ns"] = np.arange(len(again)) * 500_000
        (twice,) = traces_of([session.with_rows(again, session.truth[:0])])
        assert twice.held_s == pytest.approx(trace.held_s)
        assert [band.phase for band in twice.bands].count(Phase.BRAKING) == 2

    def test_one_without_ticks_is_left_out_and_the_others_keep_their_look(self, session, others):
        found = traces_of([session, without_ticks(others[0]), others[1]])
        assert [trace.look.letter for trace in found] == ["A", "C"]
        assert len({trace.look.marker for trace in found}) == 2

    def test_one_that_never_braked_is_shown_whole(self, session):
        (trace,) = traces_of([session.with_rows(session.ticks[:10])])
        assert not trace.braked
        assert trace.held_s == trace.whole_s
