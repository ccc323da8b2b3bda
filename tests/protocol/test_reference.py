import subprocess
import sys

import pytest

from firmware_protocol import reference, rtdac_usb2
from firmware_protocol.fields import Bits, bits


@pytest.fixture
def written(tmp_path, monkeypatch):
    path = tmp_path / "PROTOCOL.md"
    monkeypatch.setattr(reference, "PATH", path)
    return path


def row_of(name):
    return next(line for line in reference.render().splitlines() if line.startswith(f"| `{name}` |"))


def test_the_shipped_document_is_fresh():
    assert reference.PATH.read_text(encoding="utf-8") == reference.render()


def test_the_check_command_accepts_the_shipped_document():
    command = [sys.executable, "-m", "firmware_protocol.reference", "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_what_is_written_passes_the_check(written):
    assert reference.main([]) == 0
    assert reference.main(["--check"]) == 0
    assert written.read_text(encoding="utf-8") == reference.render()


def test_a_missing_document_is_stale(written, capsys):
    assert reference.main(["--check"]) == 1
    assert not written.exists()
    assert "PROTOCOL.md is stale" in capsys.readouterr().err


def test_a_changed_document_is_stale_and_left_alone_by_the_check(written, capsys):
    changed = reference.render().replace("w20[0:15]", "w20[0:16]", 1)
    written.write_text(changed, encoding="utf-8")
    assert reference.main(["--check"]) == 1
    assert "run python -m firmware_protocol.reference" in capsys.readouterr().err
    assert written.read_text(encoding="utf-8") == changed


@pytest.mark.usefixtures("written")
def test_a_changed_table_makes_the_document_stale(monkeypatch):
    assert reference.main([]) == 0
    monkeypatch.setattr(rtdac_usb2, "FIELDS", rtdac_usb2.FIELDS[:-1])
    assert reference.main(["--check"]) == 1


@pytest.mark.parametrize("arguments", [["--chek"], ["--check", "--check"], ["file"]])
def test_wrong_arguments_are_refused_and_nothing_is_written(arguments, written, capsys):
    assert reference.main(arguments) == 2
    assert not written.exists()
    assert "usage" in capsys.readouterr().err


@pytest.mark.parametrize("field", rtdac_usb2.FIELDS, ids=lambda field: field.name)
def test_every_field_has_one_row_with_its_places_status_and_source(field):
    cells = [cell.strip() for cell in row_of(field.name).strip("|").split("|")]
    assert len(cells) == 8
    assert cells[1:3] == [reference.where(field.read), reference.where(field.send)]
    assert cells[4:] == [field.unit, field.meaning, field.status.value, field.source]


@pytest.mark.parametrize(
    ("name", "read", "send", "limits"),
    [
        ("pwm0_prescaler", "w20[0:16]", "w20[0:15] + w21[0:1]", "0..65535"),
        ("pwm0_mode", "w21[0:1]", "w21[1:2]", "0..1"),
        ("pin_direction", "w12[0:16] + w13[0:10]", "w12[0:15] + w13[0:11]", "0..67108863"),
        ("encoder1_count", "w55[0:16] + w56[0:16]", "-", "-2147483648..2147483647"),
        ("chronometer0_divider", "w148[0:16] + w149[0:16]", "w148[0:15] + w149[0:15]", "0..4294967295"),
    ],
)
def test_rows_show_both_directions(name, read, send, limits):
    cells = [cell.strip() for cell in row_of(name).strip("|").split("|")]
    assert cells[1:3] == [read, send]
    assert cells[3].startswith(limits)


def test_a_range_that_differs_by_direction_says_so():
    assert "(send: ..1073741823)" in row_of("frequency_meter0_timer")


def test_the_introduction_names_commands_and_endpoints():
    head = reference.render().partition("| field |")[0]
    for fact in ("504", "0x0103", "FF 8F 00 00", "0x8F0F", "0x02", "0x84"):
        assert fact in head


def test_layout_notation():
    assert reference.where(None) == "-"
    assert reference.where(bits(3, 4, 2)) == "w3[4:6]"
    assert reference.where((Bits(1, 0, 16, 0), Bits(2, 0, 10, 16))) == "w1[0:16] + w2[0:10]"
