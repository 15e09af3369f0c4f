// The sketch as a library for tests: they give it bytes and the time, and read what it sent and where its pulses are.
#include "hexapod.ino"

Computer computer;
SerialStub Serial;
Chip chips[2];
WireStub Wire;
#ifdef ARDUINO_ARCH_RP2040
Rp2040Stub rp2040;
#endif

static uint8_t key[32];

extern "C" {

// Before `begin`: the pulse reported of each channel, the times, and 32 bytes of a key or none.
void configure(const uint16_t *start_us, uint32_t expiry_us, uint32_t release_us, const uint8_t *secret) {
  memcpy(settings.start_us, start_us, sizeof settings.start_us);
  settings.expiry_us = expiry_us;
  settings.release_us = release_us;
  if (secret != nullptr) settings.key = static_cast<const uint8_t *>(memcpy(key, secret, sizeof key));
}

void begin(uint64_t now) {
  computer.now_us = now;
  setup();
}

// One pass of the program, after bytes have arrived.
void pass_once(const uint8_t *bytes, size_t length, uint64_t now) {
  computer.now_us = now;
  computer.received.insert(computer.received.end(), bytes, bytes + length);
  do loop();
  while (!computer.received.empty());
}

// The oldest frame that was sent and not taken; its length, or 0.
size_t take(uint8_t *frame) {
  if (computer.sent.empty()) return 0;
  const std::vector<uint8_t> oldest = computer.sent.front();
  computer.sent.erase(computer.sent.begin());
  memcpy(frame, oldest.data(), oldest.size());
  return oldest.size();
}

void count(uint32_t *counts) { memcpy(counts, &board.counters(), sizeof(Counters)); }

// Before `begin`: the shortest and longest pulse of a channel.
void limit(int channel, uint16_t least, uint16_t most) {
  settings.least_us[channel] = least;
  settings.most_us[channel] = most;
}

uint32_t prescale(uint32_t oscillator_hz) { return pca9685::prescale(oscillator_hz); }

uint8_t *registers(int chip) { return chips[chip].registers; }
void answer(int chip, bool answers) { chips[chip].answers = answers ? Chip::ALWAYS : 0; }
void answer_only(int chip, int messages) { chips[chip].answers = messages; }
void lose_power(int chip) { chips[chip].reset(); }
uint8_t level(int pin) { return computer.levels[pin]; }
void press(int pin, bool pressed) { computer.levels[pin] = pressed ? LOW : HIGH; }
void supply(uint32_t input_mv) { computer.input_mv = input_mv; }
void fill(uint32_t room) { computer.room = room; }
uint32_t watchdog_ms() { return computer.watchdog_ms; }
uint32_t fed() { return computer.fed; }
bool driven_low(int pin) { return computer.driven_low[pin]; }

// How many messages the chips had taken when a pin last became low, and how many since.
uint32_t messages_before_low(int pin) { return computer.messages_before_low[pin]; }
uint32_t messages() { return computer.messages; }
}
