"""In the guest: the first RT-DAC/USB, by real pyserial on the port that the real `ftdi_sio` makes of its chip.

`python -m guest.ftdi`
"""

import time

import serial
from guest import bus
from guest.scenario import braking_stop, mock_board, prepare, save

from firmware_protocol.rtdac_usb import FRAME_BYTES, READ_REQUEST

RATE_HZ = 150
"""Now and then an exchange takes 5 ms of virtual time: the kernel hands serial data on in an ordinary thread."""
COUNT = 200
SERIAL = "900000001"
LATENCIES_MS = 16, 1


def main():
    report = {"kernel": bus.kernel(), "devices": {}}
    prepare(["inteco_abs.boards.transports.serial_link"], "ftdi_sio", rules=("--ftdi-serial", SERIAL))
    with mock_board("--board", "usb", "--serial", SERIAL) as folder:
        tty = bus.eventually(lambda: next(folder.glob("*:1.0/ttyUSB*"), None), "a serial port")
        report["devices"]["mock"] = bus.facts(folder)
        report["port"] = {"name": tty.name, "latency_timer": (tty / "latency_timer").read_text().strip()}
        report["reading_us"] = {ms: reading_us(tty, ms) for ms in LATENCIES_MS}
        save(report)
        report["stop"] = braking_stop(f"usb:/dev/{tty.name}", "sim_usb", RATE_HZ)
        report["log"] = bus.kernel_log("usb 1-1") + bus.kernel_log("ftdi_sio 1-1")
    save(report)


def reading_us(tty, latency_ms):
    """How long a reading of the board takes with this latency timer: the median, us."""
    (tty / "latency_timer").write_text(f"{latency_ms}")
    times = []
    with serial.Serial(f"/dev/{tty.name}", timeout=1.0) as port:
        for _ in range(COUNT):
            start = time.perf_counter()
            port.write(READ_REQUEST)
            assert len(port.read(FRAME_BYTES)) == FRAME_BYTES
            times.append(time.perf_counter() - start)
    return sorted(times)[COUNT // 2] * 1e6


if __name__ == "__main__":
    main()
