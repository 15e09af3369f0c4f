// Registers of a PCA9685, sixteen pulses on I2C (NXP data sheet, Rev. 4). Pure logic, as board.h.
#pragma once

#include <stdint.h>

namespace hexctl {
namespace pca9685 {

constexpr uint8_t MODE1 = 0x00, MODE2 = 0x01, FIRST = 0x06, PRESCALE = 0xFE;

// MODE1: auto-increment; or asleep, as after a loss of power. MODE2: push-pull.
constexpr uint8_t AWAKE = 0x20, ASLEEP = 0x30, PUSH_PULL = 0x04;

// Bits that must be as they were set. MODE1: external clock, auto-increment, sleep. MODE2: all that it has.
constexpr uint8_t MODE1_MASK = 0x70, MODE2_MASK = 0x1F;

constexpr uint32_t COUNTS = 4096, PULSES_HZ = 50;

// Prescaler of 50 pulses a second; the oscillator has 25 MHz, give or take a few percent.
constexpr uint8_t prescale(uint32_t oscillator_hz) {
  return (oscillator_hz + COUNTS * PULSES_HZ / 2) / (COUNTS * PULSES_HZ) - 1;
}

// Oscillations in a million counts.
constexpr uint64_t million_counts(uint32_t oscillator_hz) { return 1000000ull * (prescale(oscillator_hz) + 1); }

// Counts of the longest pulse that is not longer, and of the shortest that is not shorter.
constexpr uint32_t counts_below(uint32_t pulse_us, uint32_t oscillator_hz) {
  return static_cast<uint64_t>(pulse_us) * oscillator_hz / million_counts(oscillator_hz);
}
constexpr uint32_t counts_above(uint32_t pulse_us, uint32_t oscillator_hz) {
  return (static_cast<uint64_t>(pulse_us) * oscillator_hz + million_counts(oscillator_hz) - 1) /
         million_counts(oscillator_hz);
}

// Counts of a pulse, within the limits of its channel.
inline uint32_t counts(uint32_t pulse_us, uint32_t least_us, uint32_t most_us, uint32_t oscillator_hz) {
  const uint32_t doubled = counts_below(2 * pulse_us, oscillator_hz);
  const uint32_t nearest = (doubled + 1) / 2;
  const uint32_t least = counts_above(least_us, oscillator_hz), most = counts_below(most_us, oscillator_hz);
  return nearest < least ? least : nearest > most ? most : nearest;
}

// The four bytes of a channel; 0 counts switch it off.
inline void write(uint8_t *bytes, uint32_t counts) {
  bytes[0] = bytes[1] = 0;
  bytes[2] = counts & 255;
  bytes[3] = counts ? counts >> 8 : 0x10;
}

}  // namespace pca9685
}  // namespace hexctl
