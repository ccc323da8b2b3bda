"""Packets of USB bus monitors and the files that hold them, written out by hand."""

import struct

LINUX_USB, LINUX_USB_MMAPPED, USBPCAP = 189, 220, 249
ISOCHRONOUS, INTERRUPT, CONTROL, BULK = range(4)
IN_PROGRESS = -115
TO_HOST = 0x80


class Usbmon:
    """usbmon of Linux: `packet` makes one packet, transfers are lists of packets."""

    def __init__(self, *, mmapped=True, big_endian=False):
        self.order = ">" if big_endian else "<"
        self.mmapped = mmapped
        self.link_type = LINUX_USB_MMAPPED if mmapped else LINUX_USB
        self.numbers = iter(range(0xFFFF_8801_51D7_19C0, 1 << 64))

    def packet(
        self, number, kind, endpoint, data=b"", *, device=(1, 5), transfer=BULK, status=0, length=None, setup=None,
        flag_data=None, captured=None,
    ):  # fmt: skip
        bus, address = device
        if flag_data is None:
            flag_data = 0 if data else (ord("<") if endpoint & TO_HOST else ord(">"))
        header = struct.pack(
            f"{self.order}QBBBBHbbqiiII",
            number, ord(kind), transfer, endpoint, address, bus, ord("-") if setup is None else 0, flag_data,
            1_485_195_418, 537_817, status, len(data) if length is None else length,
            len(data) if captured is None else captured,
        )  # fmt: skip
        header += setup or bytes(8)
        if self.mmapped:
            header += struct.pack(f"{self.order}iiII", 0, 0, 0x200, 0)
        return header + data

    def out(self, endpoint, data, *, status=0, **device):
        number = next(self.numbers)
        return [
            self.packet(number, "S", endpoint, data, status=IN_PROGRESS, **device),
            self.packet(number, "C", endpoint, status=status, length=len(data), **device),
        ]

    def into(self, endpoint, data, *, status=0, **device):
        number = next(self.numbers)
        return [
            self.packet(number, "S", endpoint, status=IN_PROGRESS, length=512, **device),
            self.packet(number, "C", endpoint, data, status=status, **device),
        ]

    def control(self, setup, data, **device):
        number = next(self.numbers)
        endpoint = setup[0] & TO_HOST
        there, back = (b"", data) if endpoint else (data, b"")
        return [
            self.packet(
                number,
                "S",
                endpoint,
                there,
                setup=setup,
                transfer=CONTROL,
                status=IN_PROGRESS,
                length=len(data),
                **device,
            ),
            self.packet(number, "C", endpoint, back, transfer=CONTROL, length=len(data), **device),
        ]


class UsbPcap:
    """USBPcap of Windows; always little-endian."""

    link_type = USBPCAP
    order = "<"

    def __init__(self):
        self.numbers = iter(range(0xFFFF_FA80_0512_3010, 1 << 64))

    def packet(self, number, info, endpoint, data=b"", *, device=(1, 5), transfer=BULK, status=0, stage=None):
        bus, address = device
        tail = b"" if stage is None else bytes([stage])
        header = struct.pack(
            "<HQIHBHHBBI", 27 + len(tail), number, status, 9, info, bus, address, endpoint, transfer, len(data)
        )
        return header + tail + data

    def out(self, endpoint, data, *, status=0, **device):
        number = next(self.numbers)
        return [
            self.packet(number, 0, endpoint, data, **device),
            self.packet(number, 1, endpoint, status=status, **device),
        ]

    def into(self, endpoint, data, *, status=0, **device):
        number = next(self.numbers)
        return [
            self.packet(number, 0, endpoint, **device),
            self.packet(number, 1, endpoint, data, status=status, **device),
        ]

    def control(self, setup, data, **device):
        number = next(self.numbers)
        endpoint = setup[0] & TO_HOST
        there, back = (b"", data) if endpoint else (data, b"")
        return [
            self.packet(number, 0, 0, setup + there, transfer=CONTROL, stage=0, **device),
            self.packet(number, 1, endpoint, back, transfer=CONTROL, stage=3, **device),
        ]


def times(packets, start_us=1_485_195_418_000_000, step_us=500):
    return [(start_us + step_us * number, packet) for number, packet in enumerate(packets)]


def pcap(packets, link_type, *, order="<", nano=False):
    head = struct.pack(f"{order}IHHiIII", 0xA1B23C4D if nano else 0xA1B2C3D4, 2, 4, 0, 0, 262_144, link_type)
    per_us = 1000 if nano else 1
    return head + b"".join(
        struct.pack(f"{order}IIII", at // 1_000_000, at % 1_000_000 * per_us, len(packet), len(packet)) + packet
        for at, packet in times(packets)
    )


def block(kind, body, order):
    body += bytes(-len(body) % 4)
    size = len(body) + 12
    return struct.pack(f"{order}II", kind, size) + body + struct.pack(f"{order}I", size)


def pcapng(packets, link_type, *, order="<"):
    parts = [
        block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1), order),
        block(1, struct.pack(f"{order}HHI", link_type, 0, 262_144), order),
    ]
    for at, packet in times(packets):
        body = struct.pack(f"{order}IIIII", 0, at >> 32, at & 0xFFFFFFFF, len(packet), len(packet)) + packet
        parts.append(block(6, body, order))
    return b"".join(parts)
