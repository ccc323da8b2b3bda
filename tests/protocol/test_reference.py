import subprocess
import sys

import pytest

from firmware_protocol import reference, rtdac_pci, rtdac_usb, rtdac_usb2
from firmware_protocol.fields import Bits, bits


@pytest.fixture
def written(tmp_path, monkeypatch):
    path = tmp_path / "PROTOCOL.md"
    monkeypatch.setattr(reference, "PATH", path)
    return path


def row_of(name, heading="## RT-DAC/USB2"):
    section = reference.render().partition(f"\n{heading}")[2]
    return next(line for line in section.splitlines() if line.startswith(f"| `{name}` |"))


def cells_of(name, heading):
    return [cell.strip() for cell in row_of(name, heading).strip("|").split("|")]


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


def test_every_field_has_one_row_with_its_places_status_and_source():
    for field in rtdac_usb2.FIELDS:
        cells = [cell.strip() for cell in row_of(field.name).strip("|").split("|")]
        assert len(cells) == 8, field.name
        assert cells[1:3] == [reference.where(field.read), reference.where(field.send)], field.name
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


@pytest.mark.parametrize("version", rtdac_usb.LOGICS, ids=hex)
def test_every_field_of_the_first_generation_has_its_row_in_each_logic(version):
    for field in rtdac_usb.LOGICS[version].fields:
        cells = cells_of(field.name, f"### Logic 0x{version:04X}")
        assert cells[1:3] == [reference.where(field.read, "b"), reference.where(field.send, "b")]
        assert cells[4:] == [field.unit, field.meaning, field.status.value, field.source]


@pytest.mark.parametrize(
    ("heading", "name", "read", "send"),
    [
        ("### Logic 0x0111", "pwm0_prescaler", "b21[0:8] + b22[0:8]", "b21[0:7] + b22[0:7] + b23[0:2]"),
        ("### Logic 0x0111", "pwm0_mode", "b23[0:1]", "b23[6:7]"),
        ("### Logic 0x0111", "encoder_reset", "b41[0:4]", "b41[0:4]"),
        ("### Logic 0x0112", "encoder_reset", "b31[0:8] + b32[0:4]", "b31[0:7] + b32[0:5]"),
        ("### Logic 0x0112", "encoder11_count", "b77[0:8] + b78[0:8] + b79[0:8] + b80[0:8]", "-"),
    ],
)
def test_rows_of_frames_of_bytes(heading, name, read, send):
    assert cells_of(name, heading)[1:3] == [read, send]


@pytest.mark.parametrize(
    ("heading", "table"), [("## RT-DAC4/PCI", rtdac_pci.ABS), ("### Generic registers", rtdac_pci.GENERIC)]
)
def test_every_register_has_its_row(heading, table):
    for register in table.registers.values():
        cells = cells_of(register.name, heading)
        assert len(cells) == 10
        assert cells[1].startswith(f"0x{register.offset:02X}[{register.low}:")
        assert cells[7:] == [register.meaning, register.status.value, register.source]


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("pwm_width", ["0x6C[0:12]", "read, write", "`pwm_index`", "0..4095", "1", "-"]),
        ("counter_channels", ["0x04[12:16]", "read", "-", "0..15", "1", "-"]),
        ("supply", ["0x38[0:32]", "read", "-", "0..4294967295", "raw", "V = 92000 / count; 0 if 0"]),
    ],
)
def test_rows_of_registers(name, cells):
    assert cells_of(name, "## RT-DAC4/PCI")[1:7] == cells


def test_registers_are_in_the_order_of_their_offsets():
    section = reference.render().partition("\n## RT-DAC4/PCI")[2].partition("\n### ")[0]
    places = [line.split(" | ")[1] for line in section.splitlines() if line.startswith("| `")]
    assert len(places) == len(rtdac_pci.ABS.registers)
    assert places == sorted(places, key=lambda place: (place[:4], int(place[5:].partition(":")[0])))


@pytest.mark.parametrize(
    ("heading", "facts"),
    [
        ("## RT-DAC/USB, first generation", ("150", "`80`", "`82`", "0x81", "0x83", "Bit 7", "inferred")),
        (
            "## RT-DAC4/PCI",
            ("0x050F", "10b5:2497", "256", "64", "register 2", "0xA0, 0xA4, 0xA8", "K1", "K2", "atomic"),
        ),
    ],
)
def test_the_introductions_name_what_a_driver_must_know(heading, facts):
    head = reference.render().partition(f"\n{heading}")[2].partition("\n| ")[0]
    assert [fact for fact in facts if fact not in head] == []
