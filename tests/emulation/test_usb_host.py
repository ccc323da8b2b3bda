"""The queues of requests between host and device."""

import errno
import threading

import pytest
from drill import Drill, new_host

from inteco_abs.mock_board import Urb, UsbSpeed
from inteco_abs.mock_board.usbip.usb_device import SetupPacket

CONFIGURE = SetupPacket(0x00, 9, 1, 0, 0)


class Log(list):
    """Requests in the order in which they ended."""

    def urb(self, endpoint, **settings):
        return Urb(endpoint, self.append, **settings)

    @property
    def statuses(self):
        return [urb.status for urb in self]


@pytest.fixture
def log():
    return Log()


@pytest.fixture
def host(log):
    host = new_host(UsbSpeed.FULL)
    host.submit(log.urb(0, setup=CONFIGURE))
    assert log.pop().status == 0
    return host


def drill(host, log, request, value=0, index=0, data=b""):
    host.submit(log.urb(0, setup=SetupPacket(0x40, request, value, index, len(data)), data=data))
    return log.pop()


def test_bulk_endpoints_do_not_exist_before_a_configuration(log):
    host = new_host(UsbSpeed.FULL)
    for endpoint in (0x02, 0x84):
        with pytest.raises(OSError, match="no endpoint") as caught:
            host.submit(log.urb(endpoint, length=64))
        assert caught.value.errno == errno.ENOENT


@pytest.mark.parametrize("endpoint", [0x04, 0x82, 0x01, 0x8F])
def test_unknown_endpoints(host, log, endpoint):
    with pytest.raises(OSError, match="no endpoint"):
        host.submit(log.urb(endpoint, length=64))


def test_waiting_reads_end_in_the_order_of_their_submission(host, log):
    reads = [log.urb(0x84, length=64) for _ in range(3)]
    for read in reads:
        host.submit(read)
    assert log == []
    for text in (b"a", b"b", b"c"):
        host.submit(log.urb(0x02, data=text))
    assert [urb for urb in log if urb in reads] == reads
    assert [bytes(read.received) for read in reads] == [b"a", b"b", b"c"]


def test_cancel_keeps_what_was_received(host, log):
    read = log.urb(0x84, length=200)
    host.submit(read)
    host.submit(log.urb(0x02, data=bytes(64)))
    assert host.cancel(read)
    assert (read.status, read.actual) == (-errno.ENOENT, 64)
    assert not host.cancel(read)
    assert log.statuses == [0, -errno.ENOENT]


def test_cancel_in_the_middle_of_the_queue(host, log):
    first, second, third = (log.urb(0x84, length=64) for _ in range(3))
    for read in (first, second, third):
        host.submit(read)
    assert host.cancel(second)
    host.submit(log.urb(0x02, data=b"a"))
    host.submit(log.urb(0x02, data=b"b"))
    assert (bytes(first.received), bytes(second.received), bytes(third.received)) == (b"a", b"", b"b")


def test_cancelled_write_counts_what_the_device_took(host, log):
    drill(host, log, Drill.HOLD, 1, 0x02)
    write = log.urb(0x02, data=bytes(100))
    host.submit(write)
    assert host.cancel(write)
    assert write.actual == 0


def test_fault_ends_a_waiting_transfer_and_only_that(host, log):
    first, second = log.urb(0x84, length=64), log.urb(0x84, length=64)
    host.submit(first)
    host.submit(second)
    host.inject(0x84, -errno.EPROTO)
    assert first.status == -errno.EPROTO
    host.submit(log.urb(0x02, data=b"x"))
    assert second.status == 0


def test_fault_on_control(host, log):
    host.inject(0, -errno.EILSEQ)
    assert drill(host, log, Drill.STORE).status == -errno.EILSEQ
    assert drill(host, log, Drill.STORE).status == 0


def test_short_control_answer_that_must_not_be(host, log):
    host.submit(log.urb(0x80, setup=SetupPacket(0x80, 6, 0x0100, 0, 64), length=64, short_not_ok=True))
    assert (log[0].status, log[0].actual) == (-errno.EREMOTEIO, 18)


def test_unplugging_ends_all_transfers_and_is_reported_once(host, log):
    notified = []
    host.listeners.append(notified.append)
    reads = [log.urb(0x84, length=64) for _ in range(2)]
    for read in reads:
        host.submit(read)
    host.unplug()
    host.unplug()
    assert [read.status for read in reads] == [-errno.ESHUTDOWN] * 2
    assert notified == [False]
    with pytest.raises(OSError, match="unplugged") as caught:
        host.submit(log.urb(0x80))
    assert caught.value.errno == errno.ENODEV
    host.plug()
    host.plug()
    assert notified == [False, True]
    assert host.address == 3
    assert host.device.endpoints == ()


def test_unplug_by_the_device_itself(host, log):
    read = log.urb(0x84, length=64)
    host.submit(read)
    assert drill(host, log, Drill.UNPLUG).status == -errno.ESHUTDOWN
    assert read.status == -errno.ESHUTDOWN


def test_reset_ends_transfers_and_unconfigures(host, log):
    read = log.urb(0x84, length=64)
    host.submit(read)
    host.reset()
    assert read.status == -errno.EPROTO
    assert host.device.configuration == 0


def test_completions_may_submit_and_hold_no_lock(host):
    """A completion can wait for another thread that uses the host."""
    seen = []

    def completed(urb):
        seen.append(bytes(urb.received))
        if len(seen) < 5:
            host.submit(Urb(0x84, completed, length=64))
            other = threading.Thread(target=host.submit, args=(Urb(0x02, lambda _urb: None, data=b"more"),))
            other.start()
            other.join(5)
            assert not other.is_alive(), "the lock was held"

    host.submit(Urb(0x84, completed, length=64))
    host.submit(Urb(0x02, lambda _urb: None, data=b"more"))
    assert seen == [b"more"] * 5


def test_a_failing_completion_does_not_stop_the_bus(host, log):
    def fail(_urb):
        raise RuntimeError("mistake of the caller")

    with pytest.raises(RuntimeError):
        host.submit(Urb(0x02, fail, data=b"x"))
    host.submit(log.urb(0x84, length=64))
    assert log[0].received == b"x"


def test_many_threads(host):
    """Every request ends exactly once, whichever thread submits, cancels or answers."""
    ended, lock = [], threading.Lock()

    def completed(urb):
        with lock:
            ended.append(urb)

    def work():
        for i in range(300):
            read = Urb(0x84, completed, length=64)
            host.submit(read)
            host.submit(Urb(0x02, completed, data=b"x"))
            if i % 3 == 0:
                host.cancel(read)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    host.unplug()
    assert len(ended) == len(set(map(id, ended))) == 4 * 600
    assert {urb.status for urb in ended} <= {0, -errno.ENOENT, -errno.ESHUTDOWN}
