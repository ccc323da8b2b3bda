"""Each thing that can be wrong with a session has one line, with its place."""

import struct
import zlib

import numpy as np
import pytest

from inteco_abs.sessions import TICK, FileWriter, Severity, read_session, validate

CHUNK, ATTACHMENT, METADATA, DATA_END, STATISTICS, FOOTER, CHUNK_INDEX = 6, 9, 12, 15, 11, 2, 8


@pytest.fixture
def judged(short, container, altered):
    """Verdict and findings of the short session after a change of its records, the data's checksum right."""

    def judge(change):
        records = [found for record in container.split(short.read_bytes()) for found in change(record)]
        inspection = validate(altered(container.join(records)))
        return inspection.verdict, {finding.place: finding.problem for finding in inspection.findings}

    return judge


def of_name(container, record, name):
    return record.opcode in {METADATA, ATTACHMENT} and container.text(name) in record.content


def rechunked(container, change):
    """Every message of the ticks changed, in chunks whose checksums are right."""

    def apply(record):
        if record.opcode != CHUNK:
            return [record]
        raw = b"".join(
            bytes(fresh) for entry in container.split(container.unpack(record), 0) for fresh in change(entry)
        )
        return [container.chunk(raw, len(raw), "", zlib.crc32(raw))]

    return apply


def is_tick(entry, number):
    return entry.opcode == 5 and entry.content[:6] == struct.pack("<HI", 1, number)


def test_a_whole_session_is_well(quick):
    inspection = validate(quick.path)
    assert (inspection.verdict, inspection.ticks, inspection.findings) == ("well", quick.stop.card["ticks"], [])


def test_a_chunk_that_fails_its_checksum_is_wrong(container, judged):
    def change(record):
        if record.opcode == CHUNK and record.at > 6000:
            return [container.record(CHUNK, record.content[:-1] + bytes([record.content[-1] ^ 1]))]
        return [record]

    verdict, findings = judged(change)
    assert verdict == "wrong"
    assert any(place.startswith("bytes ") and "chunk: " in problem for place, problem in findings.items())
    assert "do not match the hash" in findings["hash"]


def test_an_attachment_that_fails_its_checksum_is_wrong(container, judged):
    verdict, findings = judged(
        lambda r: (
            [container.record(ATTACHMENT, r.content.replace(b"sim_usb2", b"sim_usb3"))]
            if r.opcode == ATTACHMENT
            else [r]
        )
    )
    assert verdict == "wrong"
    assert any("'config.toml' fails its checksum" in problem for problem in findings.values())


def test_a_data_section_that_fails_its_checksum_is_wrong(short, altered):
    data = short.read_bytes()
    at = data.index(b"inteco_abs.rig") + 40
    inspection = validate(altered(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]))
    assert inspection.verdict == "wrong"
    assert [f.problem for f in inspection.findings] == ["data end: the data section fails its checksum"]


@pytest.mark.parametrize("back", [3, 20, 30, 100, 500])
def test_an_index_that_fails_its_checksum_is_a_loss_for_viewers_only(short, altered, back):
    data = bytearray(short.read_bytes())
    data[-back] ^= 1
    inspection = validate(altered(bytes(data)))
    assert (inspection.verdict, inspection.ticks) == ("losses", 60)


def test_an_index_that_leaves_chunks_out_is_a_loss(judged):
    verdict, findings = judged(lambda r: [] if r.opcode == CHUNK_INDEX else [r])
    assert verdict == "losses"
    assert "other chunks" in findings["index"]


def test_an_index_that_counts_wrong_is_a_loss(container, judged):
    wrong = struct.pack("<Q", 7)
    verdict, findings = judged(
        lambda r: [container.record(STATISTICS, wrong + r.content[8:])] if r.opcode == STATISTICS else [r]
    )
    assert verdict == "losses"
    assert "counts 7 messages" in findings["index"]


def test_a_file_without_an_end_is_a_loss(cut_short, altered):
    inspection = validate(altered(cut_short))
    assert inspection.verdict == "losses"
    (cut, end) = inspection.findings
    assert (cut.severity, cut.place.partition(" ")[0]) == (Severity.LOSS, "bytes")
    assert "ends early" in cut.problem
    assert end[1:] == ("end", "the data has no end: what came after it is not known")


def test_ticks_that_are_missing_are_named(container, judged):
    lost = {20, 21, 22}
    verdict, findings = judged(
        rechunked(container, lambda e: [] if any(is_tick(e, number) for number in lost) else [e])
    )
    assert verdict == "wrong"  # under a hash that is of all of them
    assert findings["tick 23"] == "ticks 20..22 are missing before it"
    assert "60 ticks, the file has 57" in findings["metadata session"]


def recorded(path, ticks):
    """A session that was recorded so, with every checksum and its hash."""
    with FileWriter(path, 0) as recorder:
        recorder.begin({})
        recorder.ticks(ticks.tobytes())
        recorder.finish("completed", "", {"overruns": 0, "lost_ticks": 0, "lateness_us": {}})
    return {finding.place: (str(finding.severity), finding.problem) for finding in validate(path).findings}


@pytest.fixture
def few(short):
    """Ten ticks to write on."""
    return np.frombuffer(bytearray(read_session(short).payload[: 10 * TICK.size]), TICK.dtype)


def test_a_gap_in_the_ticks_is_a_loss(few, tmp_path):
    few["tick"][5:] += 100
    found = recorded(tmp_path / "gap.mcap", few)
    assert found["tick 105"] == ("loss", "ticks 5..104 are missing before it")


def test_the_first_ticks_missing_are_a_gap_too(few, tmp_path):
    few["tick"] += 3
    assert recorded(tmp_path / "gap.mcap", few)["tick 3"] == ("loss", "ticks 0..2 are missing before it")


def test_a_tick_that_comes_twice_is_wrong(few, tmp_path):
    few["tick"][5:] -= 1
    assert recorded(tmp_path / "twice.mcap", few)["tick 4"] == ("wrong", "comes after tick 4")


@pytest.mark.parametrize("back_ns", [0, 1, 10**9])
def test_time_that_does_not_continue_is_wrong(few, tmp_path, back_ns):
    few["time_ns"][5] = few["time_ns"][4] - np.uint64(min(back_ns, int(few["time_ns"][4])))
    assert recorded(tmp_path / "time.mcap", few)["tick 5"][0] == "wrong"


def test_messages_that_do_not_follow_each_other_are_wrong(container, judged):
    def renumber(entry):
        if not is_tick(entry, 33):
            return [entry]
        return [container.record(5, struct.pack("<HI", 1, 999) + entry.content[6:])]

    verdict, findings = judged(rechunked(container, renumber))
    assert verdict == "wrong"
    assert "is message 999" in findings["tick 33"]


def test_a_wall_clock_that_leaves_the_monotonic_one_is_wrong(container, judged):
    def shift(entry):
        if not is_tick(entry, 33):
            return [entry]
        (log_time,) = struct.unpack_from("<Q", entry.content, 6)
        return [container.record(5, entry.content[:6] + struct.pack("<Q", log_time + 1) + entry.content[14:])]

    assert "wall clock" in judged(rechunked(container, shift))[1]["tick 33"]


@pytest.mark.parametrize("name", ["rig", "controller", "timing", "result"])
def test_metadata_that_is_missing_is_a_loss(container, judged, name):
    verdict, findings = judged(lambda r: [] if of_name(container, r, f"inteco_abs.{name}") else [r])
    assert verdict == "losses"
    assert findings[f"metadata {name}"] == "is missing"


def test_a_session_without_its_outcome_is_a_loss(container, judged):
    verdict, findings = judged(lambda r: [] if container.text("outcome") in r.content else [r])
    assert verdict == "losses"
    assert findings["metadata session"] == "lacks outcome, ticks"


def test_a_session_without_its_hash_is_wrong(container, judged):
    verdict, findings = judged(lambda r: [] if of_name(container, r, "inteco_abs.integrity") else [r])
    assert verdict == "wrong"
    assert "cannot be checked against it" in findings["hash"]


def test_a_session_without_its_configuration_is_a_loss(judged):
    verdict, findings = judged(lambda r: [] if r.opcode == ATTACHMENT else [r])
    assert verdict == "losses"
    assert "cannot be replayed" in findings["attachment config.toml"]


def test_another_version_of_the_ticks_is_wrong(container, judged):
    descriptor = TICK.descriptor()
    other = descriptor.replace(b"wheel_count", b"wheel_cound")
    verdict, findings = judged(
        rechunked(container, lambda e: [container.record(e.opcode, e.content.replace(descriptor, other))])
    )
    assert verdict == "wrong"
    assert any(problem.startswith("chunk: ") and "another version" in problem for problem in findings.values())
    assert "another version of this program" in findings["schema"]


def test_records_of_a_later_version_are_not_damage(container, judged):
    verdict, findings = judged(lambda r: [r, container.record(0x81, b"later")] if r.opcode == METADATA else [r])
    assert verdict == "losses"
    assert all("index" in place + problem for place, problem in findings.items())  # which has the places from before


@pytest.mark.parametrize(
    ("data", "words"), [(b"", "it is empty"), (b"text", "starts with b'text'")], ids=["empty", "text"]
)
def test_what_is_not_a_session_is_wrong(altered, data, words):
    (finding,) = validate(altered(data)).findings
    assert (finding.severity, finding.place) == (Severity.WRONG, "file")
    assert words in finding.problem


def test_an_mcap_file_of_another_program_is_wrong(container, altered):
    inspection = validate(altered(container.craft()))
    assert inspection.verdict == "wrong"
    assert inspection.findings[-1].problem == "is an MCAP file, but not a session of this program"


def test_a_few_of_many_findings_of_a_kind_are_reported(few, tmp_path):
    many = np.frombuffer(bytearray(few.tobytes() * 30), TICK.dtype)
    many["tick"] = np.arange(300) * 2
    places = recorded(tmp_path / "many.mcap", many)
    assert len(places) < 80
    assert "tick ..." in places
