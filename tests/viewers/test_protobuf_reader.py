"""The official Python libraries for MCAP and protobuf decode the bytes that our own scanner reads."""

import struct

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from inteco_abs.sessions import TICK, TRUTH, read_session


def bits(columns, rows):
    """Every value in its own width."""
    form = struct.Struct("<" + "".join(column.kind.code for column in columns))
    return [form.pack(*row) for row in rows]


@pytest.mark.parametrize("message", [TICK, TRUTH], ids=["tick", "truth"])
def test_every_field_equals_our_readers_bit_for_bit(path, message):
    session = read_session(path)
    ours = session.ticks if message is TICK else session.truth
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [found.decoded_message for found in reader.iter_decoded_messages(topics=[message.topic])]
    declared = decoded[0].DESCRIPTOR.fields_by_name if decoded else {}
    columns = [column for column in message.columns if column.name in declared]  # older files have fewer
    theirs = [[getattr(each, column.name) for column in columns] for each in decoded]
    assert bits(columns, theirs) == bits(columns, ours[[column.name for column in columns]].tolist())
