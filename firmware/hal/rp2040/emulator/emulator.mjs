// Runs an image of the RP2040 in rp2040js: node emulator.mjs IMAGE.uf2
//
// The line to the host, at descriptor 0, is behind a USB host that takes the device's serial port into use as an operating
// system does. The file `rig` in the working folder is a line to the simulated rig: every STEP_US of the chip's time it
// gets the duties that stand at the pins of the PWM outputs, and returns the counts of the encoders at the end of
// the step, during which their pins change at even distances. The chip's time follows the computer's clock, where the
// computer is fast enough.

import fs from 'node:fs';
import { RP2040, GPIOPinState, ConsoleLogger, LogLevel } from 'rp2040js';

Error.stackTraceLimit = 0; // an empty line is an exception, ten thousand times a second

const BOOT = 0x20041f00; // where the boot ROM puts the first 256 bytes
const BOOT_BYTES = 256;
const FLASH = 0x10000000;
const CYCLE_NS = 8; // at 125 MHz
const STEP_US = 1000;
const SLICE_NS = 250_000; // between two looks at the host's line
const PWM_PINS = [16, 18];
const LONGEST_PERIOD_NS = 400_000; // of the rig's 3.5 kHz it is 286
const DUTY_FULL = 4095;
const ENCODER_PIN = 2;
const ENCODERS = 4;
const DIGITAL_PIN = 10;
const DIGITAL_PINS = 6;
const LEVELS = [0b00, 0b01, 0b11, 0b10]; // of B and A, counting up
const WANTS_COUNTS = 4;
const TWELVE_BITS = 3;

function unlessBusy(act) {
  try {
    return act();
  } catch (error) {
    if (error.code !== 'EAGAIN') {
      throw error;
    }
    return undefined;
  }
}

function flashed(file) {
  const data = fs.readFileSync(file);
  const blocks = [];
  for (let at = 0; at < data.length; at += 512) {
    const length = data.readUInt32LE(at + 16);
    blocks.push({ address: data.readUInt32LE(at + 12), bytes: data.subarray(at + 32, at + 32 + length) });
  }
  return blocks;
}

function checksum(bytes) {
  let register = 0xffffffff;
  for (const byte of bytes) {
    register ^= byte << 24;
    for (let bit = 0; bit < 8; bit++) {
      register = (register << 1) ^ (register < 0 ? 0x04c11db7 : 0);
    }
  }
  return register >>> 0;
}

// What the boot ROM does.
function boot(chip, blocks) {
  for (const { address, bytes } of blocks) {
    chip.flash.set(bytes, address - FLASH);
  }
  const first = chip.flash.subarray(0, BOOT_BYTES);
  if (checksum(first.subarray(0, BOOT_BYTES - 4)) !== chip.flashView.getUint32(BOOT_BYTES - 4, true)) {
    throw new Error('the first 256 bytes of the image have a wrong checksum: the boot ROM would not run them');
  }
  chip.sram.set(first, BOOT - 0x20000000);
  chip.core.PC = BOOT;
}

// A PWM output's duty, from the edges of its pin: that of the newest period that has ended, or the level that has stood for
// longer than LONGEST_PERIOD_NS.
class Output {
  constructor(chip, pin) {
    this.clock = chip.clock;
    this.pin = chip.gpio[pin];
    this.high = false;
    this.roseNs = -Infinity;
    this.fellNs = -Infinity;
    this.newest = 0;
    this.pin.addListener(() => this.changed());
  }

  changed() {
    const high = this.pin.value === GPIOPinState.High;
    if (high === this.high) {
      return;
    }
    const now = this.clock.nanos;
    this.high = high;
    if (!high) {
      this.fellNs = now;
      return;
    }
    if (now - this.roseNs <= LONGEST_PERIOD_NS) {
      this.newest = (this.fellNs - this.roseNs) / (now - this.roseNs);
    }
    this.roseNs = now;
  }

  duty() {
    const stoodNs = this.clock.nanos - Math.max(this.roseNs, this.fellNs);
    return stoodNs > LONGEST_PERIOD_NS ? Number(this.high) : this.newest;
  }
}

// The simulated rig at the chip's pins.
class Rig {
  constructor(chip) {
    this.chip = chip;
    this.line = fs.openSync('rig', 'r+');
    this.outputs = PWM_PINS.map((pin) => new Output(chip, pin));
    this.counts = undefined;
    this.levels = new Array(ENCODERS).fill(-1);
    this.message = Buffer.alloc(20);
    this.answer = Buffer.alloc(20);
    this.alarm = chip.clock.createAlarm(() => this.step());
    this.edges = [];
    this.edgeAlarm = chip.clock.createAlarm(() => this.edge());
  }

  start() {
    this.counts = this.exchange(0);
    this.counts.forEach((count, i) => this.show(i, count));
    this.alarm.schedule(STEP_US * 1000);
  }

  // Tells the rig the duties from here on, and returns the counts `aheadUs` later. When the outputs have gone off, it is
  // first told when the last of them was high.
  exchange(aheadUs) {
    const { outputs, chip, answer } = this;
    const duties = outputs.map((output) => output.duty());
    const on = duties.some((duty) => duty > 0);
    if (this.on && !on) {
      this.tell(Math.max(...outputs.map((output) => output.fellNs)), duties, TWELVE_BITS, 0);
    }
    this.on = on;
    const driven = this.tell(chip.clock.nanos, duties, TWELVE_BITS | WANTS_COUNTS, aheadUs);
    for (let read = 0; read < answer.length; ) {
      const more = fs.readSync(this.line, answer, read, answer.length - read, null);
      if (more === 0) {
        process.exit(0);
      }
      read += more;
    }
    const levels = answer.readUInt32LE(16);
    driven.forEach((pin, i) => pin.setInputValue(pin.outputEnable ? pin.outputValue : !!((levels >> i) & 1)));
    return [0, 4, 8, 12].map((at) => answer.readInt32LE(at));
  }

  // Sends the rig a message; returns the digital pins.
  tell(ns, duties, flags, aheadUs) {
    const { message, chip } = this;
    const digital = chip.gpio.slice(DIGITAL_PIN, DIGITAL_PIN + DIGITAL_PINS);
    const bits = (of) => digital.reduce((sum, pin, i) => sum | (of(pin) ? 1 << i : 0), 0);
    message.writeUInt32LE(Math.floor(ns / 1000) >>> 0, 0);
    duties.forEach((duty, i) => message.writeUInt16LE(Math.round(duty * DUTY_FULL), 4 + 2 * i));
    message.writeUInt8(flags, 8);
    message.writeUInt16LE(aheadUs, 10);
    message.writeUInt32LE(bits((pin) => pin.outputValue && pin.outputEnable), 12);
    message.writeUInt32LE(bits((pin) => pin.outputEnable), 16);
    fs.writeSync(this.line, message);
    return digital;
  }

  step() {
    this.edges.forEach(([, i, count]) => this.show(i, count)); // none is left, but for rounding
    this.edges = [];
    const now = this.chip.clock.nanos;
    const next = this.exchange(STEP_US);
    next.forEach((count, i) => {
      const change = (count - this.counts[i]) | 0;
      const sign = Math.sign(change);
      for (let k = 1; k <= Math.abs(change); k++) {
        const at = now + ((k - 0.5) / Math.abs(change)) * STEP_US * 1000;
        this.edges.push([at, i, (this.counts[i] + sign * k) | 0]);
      }
    });
    this.edges.sort((one, other) => one[0] - other[0]);
    this.counts = next;
    this.alarm.schedule(STEP_US * 1000);
    this.nextEdge();
  }

  nextEdge() {
    if (this.edges.length > 0) {
      this.edgeAlarm.schedule(this.edges[0][0] - this.chip.clock.nanos);
    }
  }

  edge() {
    const [, i, count] = this.edges.shift();
    this.show(i, count);
    this.nextEdge();
  }

  show(i, count) {
    const levels = LEVELS[count & 3];
    const pins = [0, 1].map((bit) => this.chip.gpio[ENCODER_PIN + 2 * i + bit]);
    pins.forEach((pin, bit) => {
      const level = !!((levels >> bit) & 1);
      if (pin.rawInputValue !== level || this.levels[i] < 0) {
        pin.setInputValue(level);
      }
    });
    this.levels[i] = levels;
  }
}

// A USB host that enumerates the device and joins its serial port with the host's line. It sends a packet when there is
// something to send: until then the device's buffer stays armed, as on a bus.
class Host {
  constructor(chip, line) {
    this.usb = chip.usbCtrl;
    this.line = line;
    this.toBoard = [];
    this.armed = 0;
    this.state = 'attached';
    this.descriptor = [];
    this.usb.onUSBEnabled = () => this.usb.resetDevice();
    this.usb.onResetReceived = () => this.request([0x80, 6, 0, 1, 0, 0, 18, 0], 'device');
    this.usb.onEndpointWrite = (endpoint, bytes) => this.received(endpoint, bytes);
    this.usb.onEndpointRead = (endpoint, size) => this.readable(endpoint, size);
  }

  request(setup, state) {
    this.state = state;
    this.descriptor = [];
    this.next = undefined;
    this.ended = false;
    this.usb.sendSetupPacket(Uint8Array.from(setup));
  }

  received(endpoint, bytes) {
    if (endpoint === 2) {
      unlessBusy(() => fs.writeSync(this.line, bytes)); // what no program reads is lost
    } else if (endpoint === 0) {
      this.control(bytes);
    }
  }

  control(bytes) {
    this.descriptor.push(...bytes);
    const { state, descriptor } = this;
    if (state === 'device' && descriptor.length === 18) {
      this.after(() => this.request([0, 5, 1, 0, 0, 0, 0, 0], 'address'));
    } else if (state === 'address') {
      this.after(() => this.request([0x80, 6, 0, 2, 0, 0, 255, 0], 'configuration'));
    } else if (state === 'configuration' && descriptor.length === (descriptor[2] | (descriptor[3] << 8))) {
      this.after(() => this.request([0x80, 6, 3, 3, 9, 4, 255, 0], 'serial'));
    } else if (state === 'serial' && descriptor.length === descriptor[0]) {
      const letters = descriptor.filter((_, i) => i >= 2 && i % 2 === 0);
      process.stderr.write(`USB serial number ${String.fromCharCode(...letters)}\n`);
      this.after(() => this.request([0, 9, 1, 0, 0, 0, 0, 0], 'configured'));
    } else if (state === 'configured') {
      this.after(() => this.request([0x21, 0x22, 3, 0, 0, 0, 0, 0], 'open'));
    }
  }

  // An answer has ended when the device has received an empty packet after it; without one, its own empty packet ends it.
  after(next) {
    this.next = next;
    this.ended ||= this.state === 'address' || this.state === 'configured';
    this.goOn();
  }

  goOn() {
    if (this.ended && this.next !== undefined) {
      setImmediate(this.next);
      this.next = undefined;
    }
  }

  readable(endpoint, size) {
    if (endpoint === 0) {
      this.usb.endpointReadDone(0, new Uint8Array(0));
      this.ended = true;
      this.goOn();
    } else {
      this.armed = size;
      this.send();
    }
  }

  give(bytes) {
    this.toBoard.push(...bytes);
    this.send();
  }

  send() {
    if (this.armed > 0 && this.toBoard.length > 0) {
      const packet = Uint8Array.from(this.toBoard.splice(0, this.armed));
      this.armed = 0;
      this.usb.endpointReadDone(2, packet);
    }
  }
}

function main(file) {
  const chip = new RP2040();
  chip.logger = new ConsoleLogger(LogLevel.Error);
  boot(chip, flashed(file));
  const line = 0;
  const host = new Host(chip, line);
  const rig = new Rig(chip);
  rig.start();
  const { clock, core } = chip;
  const buffer = Buffer.alloc(4096);
  const waiting = new Int32Array(new SharedArrayBuffer(4));
  const beganNs = process.hrtime.bigint();

  function run() {
    const end = clock.nanos + SLICE_NS;
    while (clock.nanos < end) {
      if (core.waiting) {
        clock.tick(Math.min(clock.nanosToNextAlarm, end - clock.nanos));
      } else {
        clock.tick(core.executeInstruction() * CYCLE_NS);
      }
    }
    const aheadMs = (clock.nanos - Number(process.hrtime.bigint() - beganNs)) / 1e6;
    if (aheadMs > 0.2) {
      Atomics.wait(waiting, 0, 0, aheadMs);
    }
  }

  function listen() {
    const read = unlessBusy(() => fs.readSync(line, buffer, 0, buffer.length, null)) ?? 0;
    host.give(buffer.subarray(0, read));
  }

  function forever() {
    for (let i = 0; i < 10; i++) {
      run();
      listen();
    }
    setImmediate(forever);
  }
  forever();
}

main(process.argv[2]);
