"""The generator of the firmware's tables."""

import pytest

from firmware_protocol import c_header
from firmware_protocol.fields import get_bits
from firmware_protocol.rtdac_usb import LOGICS, encode_read, encode_send


def test_a_stale_header_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(c_header, "FOLDER", tmp_path)
    assert c_header.main(["--check"]) == 1
    assert "rtdac_usb_tables.h is stale: run python -m firmware_protocol.c_header" in capsys.readouterr().err
    assert c_header.main([]) == 0
    assert c_header.main(["--check"]) == 0
    assert c_header.main(["--help"]) == 2


def test_without_the_firmware_it_says_where_to_run_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(c_header, "FOLDER", tmp_path / "core")
    assert c_header.main([]) == 1
    assert "run it in the source tree" in capsys.readouterr().err


def test_the_headers_in_the_tree_are_up_to_date():
    assert c_header.main(["--check"]) == 0


@pytest.mark.parametrize("logic", LOGICS.values(), ids=lambda logic: logic.name)
def test_the_moves_carry_each_setting_to_where_a_read_frame_has_it(logic):
    version = logic.read.fixed["logic_version"]
    for name in logic.send.fields.keys() & logic.read.fields.keys():
        _, layout = logic.send.fields[name]
        highest = (1 << layout[-1].shift + layout[-1].width) - 1
        frame, image = encode_send({name: highest}, logic=version)[1:], bytearray(150)
        for move in c_header.bit_moves(logic):
            bits = frame[move.send_byte] >> move.send_low & (1 << move.width) - 1
            image[move.read_byte] |= bits << move.read_low
        assert image == bytes(2) + encode_read({name: highest}, logic=version)[2:]
        assert get_bits(image, logic.read.bytes_of(name)) == highest
