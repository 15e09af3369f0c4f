// I2C with two PCA9685 on it, as the data sheet has them: registers, auto-increment, sleep, prescaler.
#pragma once

#include "Arduino.h"

struct Chip {
  static constexpr int ALWAYS = -1;

  uint8_t registers[256];
  int answers = ALWAYS;  // how many more messages it acknowledges

  Chip() { reset(); }
  void reset() {
    memset(registers, 0, sizeof registers);
    registers[0x00] = 0x11;
    registers[0x01] = 0x04;
    registers[0xFE] = 0x1E;
    for (int channel = 0; channel < 16; ++channel) registers[6 + 4 * channel + 3] = 0x10;
  }
  void take(const std::vector<uint8_t> &message) {
    if (answers > 0) --answers;
    ++computer.messages;
    uint8_t at = message.empty() ? 0 : message[0];
    for (size_t each = 1; each < message.size(); ++each) {
      const bool sleeps = registers[0x00] & 0x10;
      if (at != 0xFE || sleeps) registers[at] = message[each];
      if (registers[0x00] & 0x20) ++at;
    }
  }
};
extern Chip chips[2];

struct WireStub {
  std::vector<uint8_t> message;
  int address = 0;
  uint8_t pointer = 0;

  Chip *chip() { return address == 0x40 ? &chips[0] : address == 0x41 ? &chips[1] : nullptr; }
#ifdef ARDUINO_ARCH_ESP32
  bool begin(int, int, uint32_t) { return true; }
  void setTimeOut(uint16_t) {}
#else
  bool setSDA(unsigned) { return true; }
  bool setSCL(unsigned) { return true; }
  void setClock(uint32_t) {}
  void begin() {}
  void setTimeout(uint32_t) {}
#endif
  void beginTransmission(uint8_t to) {
    address = to;
    message.clear();
  }
  size_t write(uint8_t byte) {
    message.push_back(byte);
    return 1;
  }
  size_t write(const uint8_t *bytes, size_t length) {
    message.insert(message.end(), bytes, bytes + length);
    return length;
  }
  uint8_t endTransmission() {
    if (chip() == nullptr || !chip()->answers) return 2;
    pointer = message[0];
    chip()->take(message);
    return 0;
  }
  uint8_t requestFrom(uint8_t from, uint8_t length) {
    address = from;
    return chip() != nullptr && chip()->answers ? length : 0;
  }
  int read() { return chip()->registers[pointer]; }
};
extern WireStub Wire;
