import os
import tempfile
from pathlib import Path

import pytest
from benches import (
    WAYS_TO_FAIL,
    ClockedBench,
    HandClock,
    PtyBench,
    SocketBench,
    Usb0111Bench,
    Usb0112Bench,
    Usb2Bench,
)
from benches_firmware import FirmwareOpenBench, FirmwareUsbBench
from benches_open import OpenBench
from benches_pci import PciBench, StepwisePciBench, SysfsBench

from firmware_protocol.rtdac_usb2 import FRAME_BYTES, READ_REQUEST, SEND_COMMAND, encode_send
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.config import load_config
from inteco_abs.mock_board import Device

BENCHES = {
    "rtdac-usb2": Usb2Bench,
    "rtdac-usb2 with a clock": ClockedBench,
    "rtdac-usb2 over a socket": SocketBench,
    "rtdac-usb 0x0111": Usb0111Bench,
    "rtdac-usb 0x0112": Usb0112Bench,
    "rtdac-usb over a pty": PtyBench,
    "rtdac4-pci": PciBench,
    "rtdac4-pci by sysfs": SysfsBench,
    "open board": OpenBench,
    "firmware of the open board": FirmwareOpenBench,
    "firmware of the open board, 0x0111": FirmwareUsbBench,
}

ONLY_LINKS = {SocketBench, PtyBench, SysfsBench, FirmwareOpenBench, FirmwareUsbBench}
"""Another of the benches has the same board at the end of another link, or the mock of this one: what it shows of the
board, these repeat."""
OVER_A_LINK = {f"test_contract_{part}" for part in ("exchange", "leaving", "opening", "rescue")}


@pytest.hookimpl(tryfirst=True)  # before tests that take long are left out
def pytest_collection_modifyitems(items):
    for item in items:
        bench = item.callspec.params.get("new_bench") if hasattr(item, "callspec") else None
        if bench in ONLY_LINKS and item.path.stem not in OVER_A_LINK:
            item.add_marker(pytest.mark.long)


@pytest.fixture(scope="session", params=BENCHES.values(), ids=BENCHES)
def new_bench(request):
    """Maker of benches; the contract tests run once for every board in `BENCHES`."""
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        if request.param is SysfsBench:
            SysfsBench.folder = Path(folder)
            patch.setattr(os, "pread", SysfsBench.live.pread)
            patch.setattr(os, "pwrite", SysfsBench.live.pwrite)
        yield request.param
        SysfsBench.close_all_but(0)
    SocketBench.close_all_but(0)
    PtyBench.close_all_but(0)


@pytest.fixture(scope="session")
def new_usb2_bench():
    return Usb2Bench


@pytest.fixture(scope="session")
def new_pci_bench():
    return StepwisePciBench


@pytest.fixture(scope="session", params=[Usb0111Bench, Usb0112Bench], ids=["0x0111", "0x0112"])
def new_usb_bench(request):
    return request.param


@pytest.fixture(scope="session")
def both_on(new_bench):
    """Outputs as an earlier program may leave them: drive and brake at full duty."""
    return new_bench.both_on


@pytest.fixture(params=WAYS_TO_FAIL)
def way(request):
    return request.param


@pytest.fixture(scope="session")
def ways_to_fail():
    return WAYS_TO_FAIL


class MockBoard:
    """The mock on its own: raw messages in, raw answers out."""

    def __init__(self, *settings: str, seed: int = 0, **device) -> None:
        self.clock = HandClock()
        self.device = Device(load_config(settings=settings), self.clock.now_ns, seed, **device)
        self.front_end = Usb2FrontEnd(self.device)

    def send(self, **settings: int) -> None:
        self.front_end.bulk_out(encode_send(settings))

    def read(self) -> bytes:
        self.front_end.bulk_out(READ_REQUEST)
        return self.front_end.bulk_in(FRAME_BYTES)

    def run(self, duration_s: float) -> None:
        """Let the rig move on, at the rate at which a loop would look at it."""
        end_ns = self.clock.time_ns + round(duration_s * 1e9)
        while self.clock.time_ns < end_ns:
            self.clock.advance(min(500_000, end_ns - self.clock.time_ns))
            self.device.catch_up()


@pytest.fixture(scope="session")
def new_mock():
    return MockBoard


@pytest.fixture
def mock(new_mock):
    return new_mock()


class Wire:
    """Frames written out by hand, without the product's tables."""

    @staticmethod
    def frame(words: dict[int, int], command: int = SEND_COMMAND) -> bytes:
        image = [0] * (FRAME_BYTES // 2)
        image[0] = command
        for index, value in words.items():
            image[index] = value
        return b"".join(word.to_bytes(2, "little") for word in image)

    @staticmethod
    def words(frame: bytes) -> list[int]:
        return [int.from_bytes(frame[at : at + 2], "little") for at in range(0, len(frame), 2)]


@pytest.fixture(scope="session")
def wire():
    return Wire
