"""The official Python libraries for MCAP and protobuf decode the bytes that our own scanner reads."""

import struct

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from inteco_abs.sessions import TICK, TRUTH, read_session


def bits(message, rows):
    """Every value in its own width."""
    form = struct.Struct("<" + "".join(column.kind.code for column in message.columns))
    return [form.pack(*row) for row in rows]


@pytest.mark.parametrize("message", [TICK, TRUTH], ids=["tick", "truth"])
def test_every_field_equals_our_readers_bit_for_bit(path, message):
    session = read_session(path)
    ours = session.ticks if message is TICK else session.truth
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [found.decoded_message for found in reader.iter_decoded_messages(topics=[message.topic])]
    theirs = [[getattr(each, column.name) for column in message.columns] for each in decoded]
    assert bits(message, theirs) == bits(message, ours.tolist())
