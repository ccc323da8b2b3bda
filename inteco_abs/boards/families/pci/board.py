"""Driver of the RT-DAC4/PCI with the ABS logic: pairs of index and data registers, a dozen accesses a tick."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from struct import Struct
from typing import Final

from firmware_protocol import ProtocolError, Register
from firmware_protocol import rtdac_pci as pci
from firmware_protocol.pwm import PWM_FULL_WIDTH, PWM_MODES
from firmware_protocol.register_messages import RegisterAccess
from firmware_protocol.registers import REGISTER_BYTES, Write
from firmware_protocol.rtdac_pci import ABS, ENCODER_COUNT, LOGIC, PWM_WIDTH
from inteco_abs.boards.authorization import read_only_reason
from inteco_abs.boards.board import STILL_ON, Board, BoardReading, Identity, Reading
from inteco_abs.boards.channels import channel_mistakes
from inteco_abs.boards.first_write import PlannedWord
from inteco_abs.boards.frame_board import widths
from inteco_abs.boards.transports.registers import Registers
from inteco_abs.config import BoardConfig
from inteco_abs.errors import BoardError, ConfigError, ConfigIssue, LinkError
from inteco_abs.signals import Command

_FIELD_NAMES: Final = {pci.PWM_MODE: "mode", pci.PWM_PRESCALER: "prescaler", PWM_WIDTH: "width"}
_NO_BOARD: Final = 0xFFFF_FFFF
"""Reading of a bus where no board answers."""
_RELIED_ON: Final = (
    *(LOGIC, pci.PWM_INDEX, pci.PWM_MODE, pci.PWM_PRESCALER, PWM_WIDTH),
    *(pci.ENCODER_INDEX, pci.ENCODER_RESET, ENCODER_COUNT),
)
_SHOWN: Final = {"supply": pci.SUPPLY, "temperature": pci.TEMPERATURE_HIGH, "velocity_window": pci.VELOCITY_WINDOW} | {
    name: ABS.find(name)
    for name in (
        *("road_velocity", "wheel_velocity", "resistor1_in_series", "resistor2_in_series", "alarm_bit0"),
        *("alarm_supply", "alarm_bit2", "maximum_road_velocity", "minimum_supply", "maximum_temperature"),
        *("resistor1_low", "resistor1_high", "resistor2_low", "resistor2_high"),
    )
}


class RtdacPci(Board):
    """Driver of the board behind `registers` with this wiring; see `Board` for its guarantees.

    A tick writes both widths, the falling one first, so that a failure in between leaves less power. Before each write
    it reads the old width, which detects another program's write or a reset. Then it reads the logic's version, which
    detects another board; both widths, each selected again, which detects an index moved by another program; and both
    counters. These readings take some microseconds, about as much as the rest, and prove that the writes have arrived:
    a bus may post them.

    Nothing rests on reading the index registers, since it is not known whether they can be read.

    Raises ConfigError for a wiring that the logic has no channels for.
    """

    def __init__(self, registers: Registers, wiring: BoardConfig, now_ns: Callable[[], int], period_ns: int) -> None:
        super().__init__(now_ns, period_ns)
        _require_channels(wiring)
        self._registers = registers
        self._wiring = wiring
        self._mode = PWM_MODES.index(wiring.pwm_mode)
        self._full = PWM_FULL_WIDTH[self._mode]
        self._outputs = (wiring.drive_pwm, wiring.brake_pwm)
        self._off: tuple[Write, ...] = tuple(write for channel in self._outputs for write in _width(channel, 0))
        self._reset = 0
        self._before = (0, 0)
        self._written = True  # whether the board must still have them: not after a partial exchange
        self._echo = (LOGIC.offset, *(step for channel in self._outputs for step in _read(PWM_WIDTH, channel)))
        encoders = (wiring.wheel_encoder, wiring.road_encoder)
        self._look = (*self._echo, *(step for channel in encoders for step in _read(ENCODER_COUNT, channel)))

    def identify(self) -> Identity:
        """Read the version. If the board has this logic and must not be driven, select and read its PWM widths too."""
        version = self._own_version(self._registers.read(LOGIC.offset))
        because = read_only_reason(self._wiring, version, None, _RELIED_ON)
        if version != pci.LOGIC_VERSION:
            own = f"this driver knows the registers of logic 0x{pci.LOGIC_VERSION:04X} only"
            because = f"{because}; {own}" if because else f"the board has logic 0x{version:04X}, and {own}"
            because += f". Whether its PWM outputs are zero is not known. {STILL_ON}"
        elif because and self._outputs_on():
            because += f". ITS PWM OUTPUTS ARE NOT ZERO and stay as they are. {STILL_ON}"
        return Identity(version, "", "", because)

    def survey(self, names: Collection[str] = ()) -> BoardReading:
        """Read the named fields, or all, once; writes nothing but the channel selection."""
        unknown = [name for name in names if name not in _FIELDS]
        if unknown:
            raise BoardError(f"{ABS.title} has no field {', '.join(unknown)}")
        chosen = {name: _FIELDS[name] for name in names or _FIELDS}
        self._require_logic()
        raw = self._registers.run([step for register, channel in chosen.values() for step in _read(register, channel)])
        values = {name: register.decode(bits) for (name, (register, _)), bits in zip(chosen.items(), raw, strict=True)}
        return BoardReading(values, b"".join(bits.to_bytes(4, "little") for bits in raw))

    def readings(self) -> list[Reading]:
        """Return measurements and limits in shop units; twenty accesses, too slow for a tick. Raises BoardError."""
        self._require_logic()
        registers = [*_SHOWN.values(), pci.TEMPERATURE_LOW]
        raw = {offset: self._registers.read(offset) for offset in sorted({one.offset for one in registers})}
        values = {one.name: one.decode(raw[one.offset]) for one in registers}
        return [
            Reading(name, _quantity(one, values), _unit(one), one.status, one.meaning) for name, one in _SHOWN.items()
        ]

    def _require_logic(self) -> None:
        """Raise BoardError for another logic, to which not even a channel selection may be written."""
        version = self._own_version(self._registers.read(LOGIC.offset))
        if version != pci.LOGIC_VERSION:
            raise BoardError(f"the board has logic 0x{version:04X}: its registers are not known")

    def _own_version(self, raw: int) -> int:
        if raw == _NO_BOARD:
            raise LinkError(
                "no board answers, all bits read 1: is it in its slot and switched on? Run inteco-abs doctor"
            )
        return LOGIC.decode(raw)

    def _outputs_on(self) -> bool:
        return any(PWM_WIDTH.decode(raw) for raw in self._registers.run(self._echo)[1:])

    def _prepare_image(self) -> None:
        self._reset = self._reset_without_ours(pci.ENCODER_RESET.decode(self._registers.read(pci.ENCODER_RESET.offset)))

    def _reset_without_ours(self, found: int) -> int:
        return found & ~(1 << self._wiring.wheel_encoder | 1 << self._wiring.road_encoder)

    def first_write(self) -> list[PlannedWord]:
        """Return the registers that entering changes; writes only channel selections."""
        settings = (*self._pwm_settings(), (PWM_WIDTH, 0))
        planned = {
            f"pwm{channel}_{_FIELD_NAMES[register]}": value for channel in self._outputs for register, value in settings
        }
        found = self.survey([*planned, pci.ENCODER_RESET.name]).values
        planned[pci.ENCODER_RESET.name] = self._reset_without_ours(int(found[pci.ENCODER_RESET.name]))
        return [
            PlannedWord(f"0x{_FIELDS[name][0].offset:02X}", (name,), int(found[name]), value)
            for name, value in planned.items()
            if found[name] != value
        ]

    @property
    def safe_image(self) -> bytes:
        """The writes that set both widths to zero, as offsets and values of 32 bits."""
        return b"".join(word.to_bytes(4, "little") for write in self._off for word in write)

    def _load_safe_image(self, image: bytes) -> None:
        words = [int.from_bytes(image[at : at + 4], "little") for at in range(0, len(image), 4)]
        self._off = tuple(map(Write, words[::2], words[1::2]))

    def _start(self) -> tuple[int, int]:
        self._write_safe()
        settings = [(register, channel, value) for channel in self._outputs for register, value in self._pwm_settings()]
        for register, channel, value in settings:
            self._registers.run(ABS.write(register, value, channel))
        self._registers.run(ABS.write(pci.ENCODER_RESET, self._reset))
        wrong = [
            f"{register.name} of channel {channel} = {echo}, not {value}"
            for register, channel, value in settings
            if (echo := register.decode(self._registers.run(_read(register, channel))[0])) != value
        ]
        reset = pci.ENCODER_RESET.decode(self._registers.read(pci.ENCODER_RESET.offset))
        if reset != self._reset:
            wrong.append(f"{pci.ENCODER_RESET.name} = {reset}, not {self._reset}")
        if wrong:
            raise BoardError(f"the board did not take its settings: {'; '.join(wrong)}")
        return self._counts(self._registers.run(self._look), 0, 0)

    def _pwm_settings(self) -> tuple[tuple[Register, int], ...]:
        return (pci.PWM_MODE, self._mode), (pci.PWM_PRESCALER, self._wiring.pwm_prescaler)

    def _transfer(self, command: Command) -> tuple[int, int]:
        drive, brake = new = widths(command, self._full)
        writes = [_exchanged(channel, width) for channel, width in zip(self._outputs, new, strict=True)]
        before, self._before = self._before, new
        if reverse := brake < before[1] and drive >= before[0]:
            writes.reverse()
        certain, self._written = self._written, False
        first, second, *seen = self._registers.run((*writes[0], *writes[1], *self._look))
        counts = self._counts(seen, drive, brake)
        self._written = True
        had = PWM_WIDTH.decode(first), PWM_WIDTH.decode(second)
        if reverse:
            had = had[::-1]
        if certain and had != before:
            problem = f"the board had PWM widths {had}, last written were {before}"
            raise LinkError(f"{problem}: does another program drive it, or was it reset?")
        return counts

    def _write_safe(self) -> None:
        """Write both widths zero, the second even if the first fails; then read them back."""
        failure: LinkError | None = None
        self._before, self._written = (0, 0), False
        for at in range(0, len(self._off), 2):
            try:
                self._registers.run(self._off[at : at + 2])
            except LinkError as error:
                failure = error
        if failure is not None:
            raise failure
        self._check(self._registers.run(self._echo), 0, 0)
        self._written = True

    def _counts(self, values: Sequence[int], drive: int, brake: int) -> tuple[int, int]:
        """Return the counters of wheel and road from the answer to `_look`."""
        self._check(values, drive, brake)
        *_, wheel, road = values
        wiring = self._wiring
        return wiring.wheel_sign * ENCODER_COUNT.decode(wheel), wiring.road_sign * ENCODER_COUNT.decode(road)

    def _check(self, values: Sequence[int], drive: int, brake: int) -> None:
        """Raise LinkError unless the answer to `_echo` is this board's and has these widths."""
        logic = self._own_version(values[0])
        if logic != self._wiring.logic_version:
            raise LinkError(f"the board's logic is 0x{logic:04X} now: it was reset or replaced")
        echo = PWM_WIDTH.decode(values[1]), PWM_WIDTH.decode(values[2])
        if echo != (drive, brake):
            raise LinkError(
                f"the board has PWM widths {echo}, but {(drive, brake)} were written: does another program drive it?"
            )

    def _close(self) -> None:
        self._registers.close()


def _fields() -> dict[str, tuple[Register, int | None]]:
    """Return the registers for `survey` by the field names of all boards."""
    return {
        LOGIC.name: (LOGIC, None),
        **{f"pwm{i}_{name}": (register, i) for i in range(pci.PWM_CHANNELS) for register, name in _FIELD_NAMES.items()},
        pci.ENCODER_RESET.name: (pci.ENCODER_RESET, None),
        **{f"encoder{i}_count": (ENCODER_COUNT, i) for i in range(pci.ENCODER_CHANNELS)},
    }


_FIELDS: Final = _fields()


def registers_of(image: bytes) -> Iterator[tuple[str, Register, int | None, int]]:
    """Yield name, register, channel and bits of a full `survey` image; raises ValueError for another length."""
    if len(image) != REGISTER_BYTES * len(_FIELDS):
        raise ValueError(f"an image of {len(image)} bytes: {ABS.title} has {REGISTER_BYTES * len(_FIELDS)}")
    for (name, (register, channel)), (bits,) in zip(_FIELDS.items(), Struct("<I").iter_unpack(image), strict=True):
        yield name, register, channel, bits


def _width(channel: int, width: int) -> tuple[Write, Write]:
    return Write(pci.PWM_INDEX.offset, channel), Write(PWM_WIDTH.offset, width)


def _exchanged(channel: int, width: int) -> tuple[RegisterAccess, ...]:
    """Return the accesses that read the old width and write `width`."""
    select, write = _width(channel, width)
    return select, PWM_WIDTH.offset, write


def _read(register: Register, channel: int | None) -> tuple[RegisterAccess, ...]:
    return (*ABS.select(register, channel), register.offset)


def _quantity(register: Register, values: dict[str, int]) -> float | None:
    if register.conversion is None:
        return values[register.name]
    try:
        return ABS.quantity(register, values)
    except ProtocolError:
        return None


def _unit(register: Register) -> str:
    return register.conversion.unit if register.conversion is not None else register.unit


def _require_channels(wiring: BoardConfig) -> None:
    mistakes = channel_mistakes(
        wiring, pci.PWM_CHANNELS, pci.ENCODER_CHANNELS, lambda count: f"{ABS.title} has {_channels(count)}"
    )
    if wiring.constants:
        mistakes.append(ConfigIssue("board.constants", f"{ABS.title} has no frames: leave them out"))
    if wiring.numbering_pins:
        mistakes.append(ConfigIssue("board.numbering_pins", f"{wiring.numbering_pins}: {ABS.title} has {_channels(0)}"))
    if mistakes:
        raise ConfigError(mistakes)


def _channels(count: int) -> str:
    # its registers are read within the tick, so no answer can be old
    return f"channels 0..{count - 1}" if count else "no frames and no known digital pins; leave it out"
