"""The device model with faults between the board and the wheels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from firmware_protocol import signed32
from inteco_abs.config import RigConfig
from inteco_abs.mock_board.device import Device, PowerInterface, Truth
from inteco_abs.mock_board.faults.fault import Fault
from inteco_abs.mock_board.faults.schedule import Schedule

_ENCODERS: Final = ("road", "wheel")


class FaultyDevice(Device):
    """A device whose encoders and motors have the faults of `schedule`."""

    def __init__(
        self,
        config: RigConfig,
        now_ns: Callable[[], int],
        seed: int = 0,
        observe: Callable[[Truth], None] | None = None,
        *,
        schedule: Schedule,
        **more: Any,
    ) -> None:
        self.schedule = schedule
        self._held: dict[str, int] = {}
        self._true = [0, 0]
        self._offsets = [0, 0]
        """Difference between reported and true counts."""
        self._slept_ns = 0
        self._power_may_fail = any(fault.startswith(("supply=", "heat=")) for fault in schedule.times)
        super().__init__(config, lambda: now_ns() + self._slept_ns, seed, observe, **more)
        self._true = list(super().counts())

    def counts(self) -> tuple[int, int]:
        """Return the counts of road and wheel from the faulty encoders."""
        true = super().counts()
        shown = [self._count(i, name, count) for i, (name, count) in enumerate(zip(_ENCODERS, true, strict=True))]
        self._true = list(true)
        if self.schedule.acting("encoders-swapped"):
            shown.reverse()
        return signed32(shown[0]), signed32(shown[1])

    @property
    def power_interface(self) -> PowerInterface:
        """The present measurements of the power interface, with faults."""
        measured, alarm = self._supplied(), self.schedule.acting("alarm")
        return measured._replace(alarms=measured.alarms ^ int(alarm.value)) if alarm else measured

    def sleep(self, seconds: float) -> None:
        """Advance the device's time, but not the host's clock."""
        self._slept_ns += round(seconds * 1e9)

    def restart(self, settings: dict[str, int]) -> None:
        """Restart as after a brown-out: both counters at zero, and these settings."""
        self.catch_up()
        self._offsets = [-count for count in super().counts()]
        self.settings.clear()
        self.settings.update(settings)
        self._update_duties()
        self.observe()

    def _count(self, i: int, name: str, count: int) -> int:
        act, step = self.schedule.acting, signed32(count - self._true[i])
        if act(f"{name}-stuck"):
            self._offsets[i] -= step
        elif act(f"{name}-reversed"):
            self._offsets[i] -= 2 * step
        elif slips := act(f"{name}-slips"):
            self._offsets[i] -= round(slips.value * step)
        if jump := self.schedule.once(f"{name}-jump"):
            self._offsets[i] += int(jump.value)
        shown = count + self._offsets[i]
        if act(f"{name}-dither"):
            shown = self._held.setdefault(name, shown)
            return shown + (count & 1)
        if noisy := act(f"{name}-noisy"):
            most = int(noisy.value)
            return shown + self.schedule.random.randint(-most, most)
        return shown

    def _contact_opens(self) -> bool:
        return self.schedule.acting("watchdog-stuck") is None

    def _motors(self) -> tuple[float, float]:
        drive, brake = super()._motors()
        self.schedule.outputs(drive, brake)
        if self.schedule.acting("power-off") or (self._power_may_fail and not self._supplied().works):
            return 0.0, 0.0
        return self._motor("drive", drive), self._motor("brake", brake)

    def _supplied(self) -> PowerInterface:
        act, supplied = self.schedule.acting, super().power_interface
        if supply := act("supply"):
            supplied = supplied._replace(supply_v=supply.value)
        if heat := act("heat"):
            supplied = supplied._replace(temperature_celsius=heat.value)
        return supplied

    def _motor(self, name: str, duty: float) -> float:
        fault: Fault | None = self.schedule.acting(f"{name}-dead", f"{name}-stuck", f"{name}-weak")
        if fault is None:
            return duty
        return {"dead": 0.0, "stuck": fault.value, "weak": fault.value * duty}[fault.name.partition("-")[2]]
