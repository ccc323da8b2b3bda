"""Registers through the files of a PCI device: file, bytes, exclusive access, error messages."""

import errno
import os
import signal
import subprocess
import sys
from functools import partial

import pytest
from pci_bus import ADDRESS, IO_PORTS, MEMORY, add_board

from inteco_abs.boards import open_board
from inteco_abs.boards.transports.sysfs import SysfsRegisters
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError, ConfigError, LinkError

SECOND = "0000:04:00.0"
PAGE = 4096
HOLD = (
    "import sys, time; from pathlib import Path; from inteco_abs.boards.transports.sysfs import SysfsRegisters as R; \
registers = R(root=Path(sys.argv[1])); print('mine', flush=True); time.sleep(60)"
)
OPEN = "import sys; from pathlib import Path; from inteco_abs.boards.transports.sysfs import SysfsRegisters as R; \
R(root=Path(sys.argv[1]))"


@pytest.fixture
def opened(tmp_path):
    """Opens boards under the test's own /sys, and closes them."""
    boards = []

    def make(address=""):
        boards.append(SysfsRegisters(address, tmp_path))
        return boards[-1]

    yield make
    for registers in boards:
        registers.close()


@pytest.fixture
def calls(monkeypatch):
    """Reads and writes of files, as they enter the kernel."""
    seen = []
    pread, pwrite = os.pread, os.pwrite

    def note_read(fd, length, offset):
        seen.append(("read", length, offset))
        return pread(fd, length, offset)

    def note_write(fd, data, offset):
        seen.append(("write", bytes(data), offset))
        return pwrite(fd, data, offset)

    monkeypatch.setattr(os, "pread", note_read)
    monkeypatch.setattr(os, "pwrite", note_write)
    return seen


def refuse(monkeypatch, name, number):
    def fail(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, name, fail)


class TestPorts:
    def test_a_read_is_one_of_four_bytes_at_the_registers_offset(self, tmp_path, opened, calls):
        folder = add_board(tmp_path, resource2=bytes(range(256)))
        assert folder.exists()
        registers = opened()
        assert registers.read(0x6C) == 0x6F6E6D6C
        assert registers.read(0) == 0x03020100
        assert registers.read(252) == 0xFFFEFDFC
        assert calls == [("read", 4, 0x6C), ("read", 4, 0), ("read", 4, 252)]

    def test_a_write_is_one_of_four_bytes_least_significant_first(self, tmp_path, opened, calls):
        folder = add_board(tmp_path)
        opened().write(0x6C, 0x01020304)
        assert calls == [("write", bytes.fromhex("04030201"), 0x6C)]
        content = (folder / "resource2").read_bytes()
        assert content == bytes(0x6C) + bytes.fromhex("04030201") + bytes(256 - 0x70)

    def test_opening_and_closing_touch_no_register(self, tmp_path, opened, calls):
        add_board(tmp_path)
        opened().close()
        assert calls == []

    @pytest.mark.parametrize(("call", "data"), [("pread", b"\1\2\3"), ("pread", b""), ("pwrite", 3)])
    def test_an_access_of_less_than_four_bytes_is_an_error(self, tmp_path, opened, monkeypatch, call, data):
        add_board(tmp_path)
        registers = opened()
        monkeypatch.setattr(os, call, lambda *_: data)
        with pytest.raises(LinkError, match=r"0x6C.*must be 4"):
            registers.read(0x6C) if call == "pread" else registers.write(0x6C, 0)

    @pytest.mark.parametrize(
        ("number", "text"),
        [(errno.ENODEV, "is gone"), (errno.EIO, "bus failed"), (errno.EPERM, "Secure Boot"), (errno.EINVAL, "Invalid")],
    )
    def test_an_access_that_fails_says_what_to_check(self, tmp_path, opened, monkeypatch, number, text):
        add_board(tmp_path)
        registers = opened()
        refuse(monkeypatch, "pread", number)
        refuse(monkeypatch, "pwrite", number)
        with pytest.raises(LinkError, match=rf"0x50 cannot be read: .*{text}"):
            registers.read(0x50)
        with pytest.raises(LinkError, match=rf"0x50 cannot be written: .*{text}"):
            registers.write(0x50, 1)


class TestMemory:
    def test_words_are_read_and_written_at_the_registers_offset(self, tmp_path, opened, calls):
        folder = add_board(tmp_path, flags=MEMORY, start=0xFE00_0000, resource2=bytes(range(256)))
        registers = opened()
        assert registers.read(0x6C) == 0x6F6E6D6C
        assert registers.read(252) == 0xFFFEFDFC
        registers.write(0x60, 0xFFFFFFFF)
        registers.write(0, 0x01020304)
        assert registers.read(0x60) == 0xFFFFFFFF
        content = (folder / "resource2").read_bytes()
        assert content[:4] == bytes.fromhex("04030201")
        assert content[0x60:0x68] == b"\xff" * 4 + bytes(range(0x64, 0x68))
        assert calls == []

    def test_closing_it_releases_the_board(self, tmp_path, opened):
        add_board(tmp_path, flags=MEMORY, start=0xFE00_0000)
        opened().close()
        opened().close()

    def test_a_range_within_a_page_is_refused_with_the_kernels_remedy(self, tmp_path, opened):
        add_board(tmp_path, flags=MEMORY, start=0xFE00_0400)
        with pytest.raises(BoardError, match=rf"0xfe000400.*pci=resource_alignment={ADDRESS}"):
            opened()

    def test_a_mapping_that_the_kernel_refuses_releases_the_board(self, tmp_path, opened, monkeypatch):
        add_board(tmp_path, flags=MEMORY, start=0xFE00_0000)

        def fail(*_):
            raise PermissionError(errno.EPERM, "no")

        with monkeypatch.context() as patch:
            patch.setattr("mmap.mmap", fail)
            with pytest.raises(BoardError, match=r"resource2 cannot be mapped: .*Secure Boot"):
                opened()
        opened()


class TestFinding:
    def test_other_devices_are_passed_by(self, tmp_path, opened):
        add_board(tmp_path, "0000:00:00.0", vendor=b"0x8086\n")
        add_board(tmp_path, "0000:00:01.0", device=b"0x9030\n")
        add_board(tmp_path, "0000:00:02.0", vendor=None)
        add_board(tmp_path, resource2=b"\1" * 256)
        assert opened().read(0) == 0x01010101

    @pytest.mark.parametrize("address", [SECOND, "04:00.0"])
    def test_an_address_selects_one_of_several_devices(self, tmp_path, opened, address):
        add_board(tmp_path)
        add_board(tmp_path, SECOND, resource2=b"\2" * 256)
        assert opened(address).read(0) == 0x02020202

    def test_capital_letters_are_the_same_address(self, tmp_path, opened):
        add_board(tmp_path)
        opened("0000:03:0A.0")

    def test_several_are_listed_and_one_has_to_be_named(self, tmp_path, opened):
        add_board(tmp_path)
        add_board(tmp_path, SECOND)
        with pytest.raises(BoardError, match=rf"2 RT-DAC4/PCI boards.*pci:{ADDRESS}.*{SECOND}"):
            opened()

    def test_none_is_an_error_that_says_how_to_look(self, opened):
        with pytest.raises(BoardError, match=r"no RT-DAC4/PCI board \(10b5:2497\): .*none.*lspci"):
            opened()

    def test_one_at_another_address_is_not_taken(self, tmp_path, opened):
        add_board(tmp_path)
        with pytest.raises(BoardError, match=rf"at {SECOND}: .*Seen: {ADDRESS}"):
            opened(SECOND)

    @pytest.mark.parametrize(
        ("files", "text"),
        [
            ({"enable": b"0\n"}, r"switched off: echo 1 \| sudo tee .*/enable.*doctor --rules"),
            ({"resource": None}, "no line for BAR 2"),
            ({"resource": b"0x0 0x0 0x0\n"}, "no line for BAR 2"),
            ({"resource": b"1 2\n" * 3}, "no line for BAR 2"),
            ({"resource": b"none of these\n" * 3}, "no line for BAR 2"),
            ({"size": 0}, "BAR 2 is empty"),
            ({"size": 128}, "128 bytes, must be 256"),
            ({"flags": MEMORY, "start": 0xFE000000, "size": 128}, "128 bytes, must be 256"),
            ({"resource2": None}, r"no .*/resource2: put the board into another slot"),
        ],
    )
    def test_a_board_whose_registers_are_not_there_says_what_to_do(self, tmp_path, opened, files, text):
        add_board(tmp_path, **files)
        with pytest.raises(BoardError, match=text):
            opened()

    def test_a_kernel_without_the_setting_is_accepted(self, tmp_path, opened):
        add_board(tmp_path, enable=None)
        opened()

    def test_a_range_larger_than_needed_is_accepted(self, tmp_path, opened):
        add_board(tmp_path, size=1024)
        opened()

    def test_without_permission_the_rules_are_named(self, tmp_path, without_privileges):
        (add_board(tmp_path) / "resource2").chmod(0o444)
        run = subprocess.run(
            [*without_privileges, sys.executable, "-c", OPEN, tmp_path], capture_output=True, text=True, check=False
        )
        assert "no permission: inteco-abs doctor --rules" in run.stderr
        assert "BoardError" in run.stderr


@pytest.mark.parametrize("flags", [IO_PORTS, MEMORY])
class TestOwner:
    @pytest.fixture
    def other(self, tmp_path, flags):
        """Another process that has the board."""
        add_board(tmp_path, flags=flags, start=PAGE)
        process = subprocess.Popen([sys.executable, "-c", HOLD, tmp_path], stdout=subprocess.PIPE, text=True)
        assert process.stdout.readline() == "mine\n"
        yield process
        process.kill()
        process.communicate()

    def test_a_board_that_another_program_has_is_refused(self, other, opened):
        with pytest.raises(BoardError, match=r"another program has the board.*one program at a time"):
            opened()
        assert other.poll() is None

    def test_a_killed_owner_leaves_the_board_to_the_next(self, other, opened):
        other.send_signal(signal.SIGKILL)
        other.wait()
        opened()

    def test_a_second_opening_in_the_same_process_is_refused_too(self, tmp_path, opened, flags):
        add_board(tmp_path, flags=flags, start=PAGE)
        first = opened()
        with pytest.raises(BoardError, match="another program has the board"):
            opened()
        first.close()
        opened()

    def test_a_program_that_it_starts_does_not_keep_the_board(self, tmp_path, opened, flags):
        add_board(tmp_path, flags=flags, start=PAGE)
        registers = opened()
        child = subprocess.Popen(
            [sys.executable, "-c", "print(); input()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, close_fds=False
        )
        child.stdout.readline()
        registers.close()
        opened()
        child.communicate(b"\n")


def test_boards_of_one_computer_are_owned_one_by_one(tmp_path, opened):
    add_board(tmp_path)
    add_board(tmp_path, SECOND)
    opened(ADDRESS)
    opened(SECOND)


def test_the_address_pci_opens_the_registers_of_this_computer(tmp_path, monkeypatch):
    add_board(tmp_path)
    add_board(tmp_path, SECOND, resource2=b"\x10\x05" + bytes(254))
    monkeypatch.setattr("inteco_abs.boards.families.pci.SysfsRegisters", partial(SysfsRegisters, root=tmp_path))
    with open_board("pci:04:00.0", load_config(profile="pci_abs_50f"), lambda: 0) as board:
        assert board.identity.logic_version == 0x0510
        assert board.identity.read_only_because
    assert (tmp_path / "bus/pci/devices" / SECOND / "resource2").read_bytes() == b"\x10\x05" + bytes(254)


def test_the_address_pci_needs_a_profile_of_that_board():
    with pytest.raises(ConfigError, match=r"board\.kind"):
        open_board("pci:", load_config(), lambda: 0)
