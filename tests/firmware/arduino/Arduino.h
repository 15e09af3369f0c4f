// The few of Arduino's functions that the sketch uses, on a computer: its time, pins and line are set by tests.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <deque>
#include <vector>

enum { LOW = 0, HIGH = 1 };
enum { INPUT_PULLUP = 2, OUTPUT = 3 };

constexpr int PINS = 64;

struct Computer {
  uint64_t now_us = 0;
  uint8_t levels[PINS] = {};
  uint8_t modes[PINS] = {};
  uint32_t input_mv = 0;          // at the analog input
  uint32_t room = 4096;           // bytes that the line takes
  std::deque<uint8_t> received;
  std::vector<std::vector<uint8_t>> sent;
  uint32_t watchdog_ms = 0, fed = 0;
  uint32_t messages = 0;          // that chips have taken
  uint32_t messages_before_low[PINS] = {};
  bool driven_low[PINS] = {};     // whether the pin became an output while it was low
};
extern Computer computer;

inline unsigned long micros() { return static_cast<uint32_t>(computer.now_us); }
inline void pinMode(uint8_t pin, uint8_t mode) {
  computer.modes[pin] = mode;
  computer.driven_low[pin] = mode == OUTPUT && computer.levels[pin] == LOW;
}
inline void digitalWrite(uint8_t pin, uint8_t level) {
  if (level == LOW && computer.levels[pin] != LOW) computer.messages_before_low[pin] = computer.messages;
  computer.levels[pin] = level;
}
inline int digitalRead(uint8_t pin) { return computer.levels[pin]; }

struct SerialStub {
  void begin(unsigned long) {}
  int available() { return static_cast<int>(computer.received.size()); }
  int read() {
    const int byte = computer.received.front();
    computer.received.pop_front();
    return byte;
  }
  int availableForWrite() { return static_cast<int>(computer.room); }
  size_t write(const uint8_t *bytes, size_t length) {
    computer.sent.emplace_back(bytes, bytes + length);
    return length;
  }
#ifdef ARDUINO_ARCH_ESP32
  size_t setRxBufferSize(size_t size) { return size; }
  size_t setTxBufferSize(size_t size) { return size; }
#endif
};
extern SerialStub Serial;

#ifdef ARDUINO_ARCH_ESP32
#define ARDUINO_USB_CDC_ON_BOOT 0
inline uint32_t analogReadMilliVolts(uint8_t) { return computer.input_mv; }
inline void enableLoopWDT() { computer.watchdog_ms = 5000; }
#else
inline void analogReadResolution(int) {}
inline int analogRead(uint8_t) { return static_cast<int>(computer.input_mv * 4095 / 3300); }
struct Rp2040Stub {
  void wdt_begin(uint32_t delay_ms) { computer.watchdog_ms = delay_ms; }
  void wdt_reset() { ++computer.fed; }
};
extern Rp2040Stub rp2040;
#endif
