"""The verbs on session files: exit codes, JSON on stdout, talk on stderr."""

import json
import os

import pytest

from inteco_abs.sessions import read_session


@pytest.fixture
def folder(tmp_path, short, quick, cut_short):
    """A whole session, another, and one that was cut."""
    (tmp_path / "a.mcap").write_bytes(short.read_bytes())
    (tmp_path / "b.mcap").write_bytes(quick.path.read_bytes())
    (tmp_path / "cut.mcap").write_bytes(cut_short)
    return tmp_path


class TestList:
    def test_every_session_has_a_line(self, verb, folder):
        done = verb("list", folder)
        assert (done.code, done.err) == (3, "")
        head, *lines = done.out.splitlines()
        assert head.split()[:3] == ["session", "date", "outcome"]
        assert {line.split()[0] for line in lines} == {"a.mcap", "b.mcap", "cut.mcap"}
        assert "ends early" in next(line for line in lines if line.startswith("cut"))

    def test_list_json_has_the_sorted_sessions(self, verb, folder):
        report = verb("list", folder, "--json", "--sort", "ticks", "--reverse").json
        assert report["schema_version"] == 1
        assert [row["session"].rpartition("/")[2] for row in report["sessions"]] == ["b.mcap", "a.mcap", "cut.mcap"]

    def test_whole_sessions_are_0(self, verb, folder):
        (folder / "cut.mcap").unlink()
        assert verb("list", folder).code == 0

    def test_an_empty_folder_is_said_to_be_empty(self, verb, tmp_path):
        done = verb("list", tmp_path)
        assert (done.code, done.out) == (0, "")
        assert "no sessions found; --recursive also searches its folders" in done.err
        assert "--recursive" not in verb("list", tmp_path, "--recursive").err

    def test_a_narrow_terminal_does_without_columns_and_names_them(self, verb, folder, monkeypatch):
        monkeypatch.setenv("COLUMNS", "80")
        wide = verb("list", folder).out
        assert max(map(len, wide.splitlines())) > 110
        monkeypatch.setattr("sys.stdout.isatty", lambda: True)
        done = verb("list", folder)
        head, *lines = done.out.splitlines()
        assert len(head) <= 80
        assert "controller" in head
        assert "rms est." not in head
        assert {line.split()[0] for line in lines} == {"a.mcap", "b.mcap", "cut.mcap"}
        assert done.err.startswith("inteco-abs: columns left out: rms est., estimator")
        monkeypatch.setenv("COLUMNS", "200")
        assert verb("list", folder).out == wide

    def test_an_unknown_column_is_wrong_usage(self, verb, folder):
        done = verb("list", folder, "--sort", "tick")
        assert done.code == 2
        assert "did you mean ticks?" in done.err

    def test_a_missing_folder_fails(self, verb, folder):
        assert verb("list", folder / "nowhere").code == 1
        assert verb("list", folder / "a.mcap").code == 1

    def test_names_and_texts_of_files_do_not_reach_the_terminal_as_they_are(self, verb, folder):
        (folder / "\x1b[31mred.mcap").write_bytes(b"\x1b[2J")
        assert "\x1b" not in verb("list", folder).out


class TestValidate:
    def test_all_is_well(self, verb, folder):
        done = verb("validate", folder / "a.mcap", folder / "b.mcap")
        assert done.code == 0
        assert done.out.splitlines()[0] == f"{folder / 'a.mcap'}: well, 60 ticks"

    def test_the_worst_file_decides(self, verb, folder):
        assert verb("validate", folder / "a.mcap", folder / "cut.mcap").code == 3
        (folder / "text.mcap").write_text("text")
        assert verb("validate", folder / "cut.mcap", folder / "text.mcap", folder / "a.mcap").code == 1
        assert verb("validate", folder / "nothing.mcap").code == 1

    def test_each_finding_is_one_line_with_its_place(self, verb, folder):
        lines = verb("validate", folder / "cut.mcap").out.splitlines()
        assert all(line.startswith(f"{folder / 'cut.mcap'}: ") for line in lines)
        assert any(": bytes " in line and ": loss: the file ends early" in line for line in lines)

    def test_validate_json_has_verdicts_and_findings(self, verb, folder):
        report = verb("validate", folder / "a.mcap", folder / "cut.mcap", "--json").json
        assert report["schema_version"] == 1
        assert [each["verdict"] for each in report["sessions"]] == ["well", "losses"]
        assert set(report["sessions"][1]["findings"][0]) == {"severity", "place", "problem"}

    def test_no_file_is_usage(self, verb):
        assert verb("validate").code == 2


class TestRecover:
    def test_with_losses(self, verb, folder):
        done = verb("recover", folder / "cut.mcap", "-o", folder / "new.mcap")
        assert done.code == 3
        assert "ticks recovered, with losses" in done.out
        assert "  lost: the data has no end" in done.out
        assert len(read_session(folder / "new.mcap").ticks) > 0

    def test_a_name_under_which_list_would_not_find_it_is_refused(self, verb, folder):
        for new in ("new.txt", "new"):
            done = verb("recover", folder / "cut.mcap", "-o", folder / new)
            assert done.code == 2
            assert f"{new}: must end in .mcap" in done.err
            assert not (folder / new).exists()

    def test_file_that_lost_only_its_index_is_recovered_whole(self, verb, folder):
        (folder / "index.mcap").write_bytes((folder / "a.mcap").read_bytes()[:-300])
        done = verb("recover", folder / "index.mcap", "-o", folder / "new.mcap")
        assert done.code == 0
        assert "60 ticks recovered, nothing was lost" in done.out

    def test_json_is_the_card_and_what_is_missing(self, verb, folder):
        report = verb("recover", folder / "cut.mcap", "-o", folder / "new.mcap", "--json").json
        assert (report["schema_version"], report["outcome"]) == (1, "recovered")
        assert report["missing_ticks"] == []
        assert any("no end" in loss for loss in report["losses"])

    def test_a_pipe_is_refused_and_not_waited_for(self, verb, tmp_path):
        os.mkfifo(tmp_path / "pipe")
        end = os.open(tmp_path / "pipe", os.O_RDWR | os.O_NONBLOCK)
        try:
            os.write(end, bytes(100))
            done = verb("recover", tmp_path / "pipe", "-o", tmp_path / "new.mcap")
            assert (done.code, os.read(end, 100)) == (1, bytes(100))
        finally:
            os.close(end)
        assert "it is not a regular file" in done.err

    @pytest.mark.parametrize("data", [b"", b"text"])
    def test_nothing_to_recover(self, verb, altered, tmp_path, data):
        done = verb("recover", altered(data), "-o", tmp_path / "new.mcap")
        assert done.code == 1
        assert "nothing to recover" in done.err

    def test_a_missing_file_is_named(self, verb, tmp_path):
        done = verb("recover", tmp_path / "nothing.mcap", "-o", tmp_path / "new.mcap")
        assert done.code == 1
        assert "No such file" in done.err

    def test_a_ring_of_another_version_is_reported_as_a_ring(self, verb, altered, tmp_path):
        done = verb("recover", altered(b"inteco-abs ring 9\n" + bytes(100)), "-o", tmp_path / "new.mcap")
        assert done.code == 1
        assert "not a tick ring of this version" in done.err

    def test_an_existing_file_is_usage(self, verb, folder):
        assert verb("recover", folder / "cut.mcap", "-o", folder / "a.mcap").code == 2


class TestReplayBehindAGap:
    @pytest.fixture
    def recovered_without_chunk(self, verb, short, container, tmp_path):
        def recovered(number):
            records = container.split(short.read_bytes())
            del records[[at for at, record in enumerate(records) if record.opcode == 6][number]]
            (tmp_path / "damaged.mcap").write_bytes(container.magic + b"".join(map(bytes, records)))
            verb("recover", tmp_path / "damaged.mcap", "-o", tmp_path / "gap.mcap")
            return tmp_path / "gap.mcap"

        return recovered

    def test_what_comes_before_the_gap_is_replayed(self, verb, recovered_without_chunk):
        gap = recovered_without_chunk(3)
        done = verb("replay", gap, "--json")
        assert done.code == 3
        assert (done.json["ticks"], done.json["differing"], done.json["left_out"]) == (20, 0, 30)
        done = verb("replay", gap)
        assert "30 ticks after a gap cannot be replayed" in done.err

    def test_a_session_without_its_first_ticks_is_not_replayed(self, verb, recovered_without_chunk):
        gap = recovered_without_chunk(1)
        done = verb("replay", gap)
        assert done.code == 1
        assert "ticks 0..9 are missing" in done.err


class TestExport:
    def test_beside_the_session_by_default(self, verb, folder):
        done = verb("export", folder / "a.mcap", "--format", "csv")
        assert done.code == 0
        assert done.out.splitlines()[0] == f"{folder / 'a.csv'}: tick, 60 rows"
        assert (folder / "a.truth.csv").exists()

    def test_export_json_names_the_files_and_what_is_missing(self, verb, folder):
        done = verb("export", folder / "cut.mcap", "--format", "npz", "-o", folder / "x.npz", "--json")
        assert done.code == 3
        assert done.json["schema_version"] == 1
        assert [each["path"] for each in done.json["files"]] == [str(folder / "x.npz")]
        assert "ends early" in done.json["incomplete"]

    def test_the_format_follows_from_the_name(self, verb, folder):
        assert verb("export", folder / "a.mcap", "-o", folder / "x.npz").code == 0
        assert (folder / "x.npz").read_bytes().startswith(b"PK")

    def test_a_name_that_is_not_the_formats_is_refused(self, verb, folder):
        for name, words in (("x.csv", "x.csv: must end in .npz"), ("x", "x: must end in .npz")):
            done = verb("export", folder / "a.mcap", "--format", "npz", "-o", folder / name)
            assert done.code == 2
            assert words in done.err
            assert not (folder / name).exists()
        assert ".csv, .npz, .mat, .parquet" in verb("export", folder / "a.mcap", "-o", folder / "x.txt").err

    def test_an_unknown_format_is_wrong_usage(self, verb, folder):
        assert verb("export", folder / "a.mcap", "--format", "xls").code == 2
        assert verb("export", folder / "a.mcap").code == 2

    def test_a_damaged_session_fails(self, verb, folder, with_a_flipped_bit):
        (folder / "bad.mcap").write_bytes(with_a_flipped_bit((folder / "a.mcap").read_bytes()))
        assert verb("export", folder / "bad.mcap", "--format", "npz").code == 1
        assert not (folder / "bad.npz").exists()


class TestGet:
    def test_the_files_in_a_session_are_listed(self, verb, folder):
        done = verb("extract", folder / "a.mcap")
        assert done.code == 0
        assert done.out.startswith("config.toml  ")
        assert next(iter(verb("extract", folder / "a.mcap", "--json").json["attachments"])) == "config.toml"

    def test_to_standard_output(self, verb, folder):
        done = verb("extract", folder / "a.mcap", "config.toml")
        assert done.out.encode() == read_session(folder / "a.mcap").attachments["config.toml"]

    def test_to_a_file(self, verb, folder):
        done = verb("extract", folder / "a.mcap", "config.toml", "-o", folder / "c.toml", "--json")
        assert (done.code, done.json["path"]) == (0, str(folder / "c.toml"))
        assert verb("extract", folder / "a.mcap", "config.toml", "-o", folder / "d.toml").code == 0

    def test_usage(self, verb, folder):
        assert verb("extract", folder / "a.mcap", "conf").code == 2
        assert verb("extract", folder / "a.mcap", "-o", folder).code == 2
        assert verb("extract", folder / "a.mcap", "config.toml", "--json").code == 2

    def test_from_a_cut_session(self, verb, folder):
        assert verb("extract", folder / "cut.mcap", "config.toml").code == 3


class TestDiff:
    def test_a_session_and_itself(self, verb, folder):
        done = verb("diff", folder / "a.mcap", folder / "a.mcap")
        assert done.code == 0
        assert "do not differ" in done.out

    def test_two_sessions(self, verb, folder):
        done = verb("diff", folder / "a.mcap", folder / "b.mcap")
        assert done.code == 4
        assert {"result", "configuration"} <= {line for line in done.out.splitlines() if not line.startswith(" ")}

    def test_only_the_requested_sections_decide(self, verb, folder):
        done = verb("diff", folder / "a.mcap", folder / "b.mcap", "--only", "gains", "--only", "rig")
        assert done.code == 0

    def test_diff_json_has_the_changed_keys(self, verb, folder):
        report = verb("diff", folder / "a.mcap", folder / "b.mcap", "--json", "--only", "configuration").json
        assert (report["schema_version"], report["equal"]) == (1, False)
        assert list(report["changes"]) == ["configuration"]
        assert set(report["changes"]["configuration"][0]) == {"key", "a", "b"}

    def test_a_cut_session_that_is_otherwise_equal_is_a_loss(self, verb, folder):
        assert verb("diff", folder / "a.mcap", folder / "cut.mcap", "--only", "gains").code == 3

    def test_signals_have_a_line_each(self, verb, run, quick):
        other = run("controller.gains.Mk=9.0", name="other.mcap").path
        done = verb("diff", quick.path, other, "--only", "signals")
        assert any(
            line.startswith("  road_speed_rad_s: up to ") and "rad/s at" in line for line in done.out.split("\n")
        )

    def test_an_unknown_section_is_wrong_usage(self, verb, folder):
        done = verb("diff", folder / "a.mcap", folder / "b.mcap", "--only", "gain", "--only", "rug")
        assert done.code == 2
        assert "did you mean gains?" in done.err
        assert "did you mean rig?" in done.err


def test_info_begins_with_how_it_ended(verb, folder, monkeypatch):
    monkeypatch.chdir(folder)
    rows = [line.split(maxsplit=1) for line in verb("info", "a.mcap").out.splitlines()]
    assert [row[0] for row in rows[:3]] == ["session", "outcome", "reason"]
    assert rows[1][1].strip() == "completed"


def test_info_says_which_process_died_and_at_which_tick(verb, short, container, altered):
    records = []
    for record in container.split(short.read_bytes()):
        if container.text("inteco_abs.session") in record.content:
            content = b"".join(container.text(text) for text in ("died", "loop", "last_tick", "9876"))
            name = container.text("inteco_abs.session")
            record = container.record(12, name + len(content).to_bytes(4, "little") + content)  # noqa: PLW2901
        records.append(record)
    out = verb("info", altered(container.join(records))).out
    assert "died loop; the last tick is 9876" in [" ".join(line.split()) for line in out.splitlines()]


def test_a_cut_session_is_said_to_be_recoverable(verb, folder):
    assert "ticks are complete; recover makes a session of them" in verb("info", folder / "cut.mcap").err


def test_info_of_a_session_whose_card_is_not_json(verb, short, container, altered):
    records = []
    for record in container.split(short.read_bytes()):
        if container.text("inteco_abs.result") in record.content:
            content = container.text("card") + container.text("{broken")
            name = container.text("inteco_abs.result")
            record = container.record(12, name + len(content).to_bytes(4, "little") + content)  # noqa: PLW2901
        records.append(record)
    done = verb("info", altered(container.join(records)), "--json")
    assert done.code == 0
    assert json.loads(done.out)["result"] is None
