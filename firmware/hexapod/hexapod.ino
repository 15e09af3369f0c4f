// Servo board for hexctl on an ESP32 or RP2040: two PCA9685 for 18 servos, foot switches, battery voltage.
//
// Tested on a computer with simulated chips only, never on a board: hold your robot off the floor. See ../README.md.

#include <Arduino.h>
#include <Wire.h>

#include "board.h"
#include "config.h"
#include "pca9685.h"

using namespace hexctl;

constexpr uint8_t ADDRESSES[] = SERVO_BOARDS;
constexpr int FEET[LEGS] = PINS_FEET;
constexpr int OUTPUTS = 9;  // in use of each PCA9685
constexpr uint32_t I2C_HZ = 400000, I2C_TIMEOUT_MS = 5;

// If the program hangs for so long, the chip restarts, and OE releases the servos. An ESP32 waits for 5 s.
constexpr uint32_t WATCHDOG_MS = 1000;

// Period in ticks in which the PCA9685 are checked for a loss of power.
constexpr uint32_t CHECK_TICKS = 25;

// Readings of wrong settings after which they count as lost.
constexpr int READINGS = 3;

constexpr const char *MUTE = "a PCA9685 does not answer", *LOST = "a PCA9685 lost its power";

#ifdef SIGNING_KEY
constexpr uint8_t KEY[32] = SIGNING_KEY;
#endif

class SerialLine : public Line {
 public:
  bool send(const uint8_t *frame, size_t length) override {
    return Serial.availableForWrite() >= static_cast<int>(length) && Serial.write(frame, length) == length;
  }
};

Settings settings(LEAST_US, MOST_US, START_US);
SerialLine line;
Board board(settings, line);

bool written = false;      // whether the PCA9685 have the pulses of this revision
uint32_t revision = 0;
uint64_t tick_at = 0;
uint32_t ticks = 0;

// Microseconds since start, one second ahead, as zero is no time; micros returns to zero after 71 minutes.
uint64_t now_us() {
  static uint64_t total = 1000000;
  static uint32_t last = 0;
  const uint32_t now = micros();
  total += static_cast<uint32_t>(now - last);
  last = now;
  return total;
}

// Write bytes to a PCA9685 from a register on; false without an acknowledgement.
bool transmit(uint8_t address, uint8_t reg, const uint8_t *bytes, size_t length) {
  Wire.beginTransmission(address);
  Wire.write(reg);
  Wire.write(bytes, length);
  return Wire.endTransmission() == 0;
}

bool transmit(uint8_t address, uint8_t reg, uint8_t byte) { return transmit(address, reg, &byte, 1); }

// Value of a register, or -1.
int receive(uint8_t address, uint8_t reg) {
  Wire.beginTransmission(address);
  Wire.write(reg);
  if (Wire.endTransmission() != 0 || Wire.requestFrom(address, static_cast<uint8_t>(1)) != 1) return -1;
  return Wire.read();
}

// Whether a PCA9685 runs as `check_boards` sets it up: 1 or 0, or -1 without an answer.
int runs(uint8_t address) {
  for (int reading = 0; reading < READINGS; ++reading) {
    const int mode1 = receive(address, pca9685::MODE1), mode2 = receive(address, pca9685::MODE2);
    const int prescale = receive(address, pca9685::PRESCALE);
    if (mode1 < 0 || mode2 < 0 || prescale < 0) return -1;
    if ((mode1 & pca9685::MODE1_MASK) == pca9685::AWAKE && (mode2 & pca9685::MODE2_MASK) == pca9685::PUSH_PULL &&
        prescale == pca9685::prescale(OSCILLATOR_HZ)) {
      return 1;
    }
  }
  return 0;
}

// Set up the PCA9685 that lost their settings, or have those of another program; the fault, or nullptr.
//
// A loss releases all servos: those of one board would return to their pose together, at full speed.
const char *check_boards() {
  for (const uint8_t address : ADDRESSES) {
    const int as_set = runs(address);
    if (as_set < 0) return MUTE;
    if (as_set) continue;
    written = false;
    digitalWrite(PIN_OE, HIGH);
    if (ticks) board.stop();
    if (!transmit(address, pca9685::MODE1, pca9685::ASLEEP) ||  // the prescaler can only be set in sleep
        !transmit(address, pca9685::PRESCALE, pca9685::prescale(OSCILLATOR_HZ)) ||
        !transmit(address, pca9685::MODE2, pca9685::PUSH_PULL) || !transmit(address, pca9685::MODE1, pca9685::AWAKE)) {
      return MUTE;
    }
  }
  return board.stopped() ? LOST : nullptr;
}

// Give the pulses to the PCA9685, which change their outputs together at the end of a message.
bool write_pulses() {
  int channel = 0;
  for (const uint8_t address : ADDRESSES) {
    uint8_t bytes[4 * OUTPUTS];
    for (int output = 0; output < OUTPUTS; ++output, ++channel) {
      const uint16_t pulse = board.pulse(channel);
      pca9685::write(&bytes[4 * output], pulse ? pca9685::counts(pulse, settings.least_us[channel],
                                                                 settings.most_us[channel], OSCILLATOR_HZ)
                                               : 0);
    }
    if (!transmit(address, pca9685::FIRST, bytes, sizeof bytes)) return false;
  }
  return true;
}

// Pulses first, then OE: servos move to what was commanded, and to nothing that the PCA9685 had before.
void move_servos() {
  if (!board.driven()) digitalWrite(PIN_OE, HIGH);
  if (!written || revision != board.revision()) {
    revision = board.revision();
    written = write_pulses();
  }
  if (board.driven() && written) digitalWrite(PIN_OE, LOW);
}

void sense() {
  uint8_t feet = 0;
  bool all = true;
  for (int leg = 0; leg < LEGS; ++leg) {
    all = all && FEET[leg] >= 0;
    if (FEET[leg] >= 0 && digitalRead(FEET[leg]) == LOW) feet |= 1 << leg;
  }
  if (all) board.set_contacts(feet);
#if PIN_BATTERY >= 0
#ifdef ARDUINO_ARCH_ESP32
  const uint32_t input_mv = analogReadMilliVolts(PIN_BATTERY);
#else
  const uint32_t input_mv = analogRead(PIN_BATTERY) * 3300u / 4095u;
#endif
  board.set_battery(input_mv * BATTERY_DIVIDER);
#endif
}

void setup() {
  digitalWrite(PIN_OE, HIGH);  // before it becomes an output
  pinMode(PIN_OE, OUTPUT);
  digitalWrite(PIN_OE, HIGH);
  for (const int pin : FEET) {
    if (pin >= 0) pinMode(pin, INPUT_PULLUP);
  }
#ifdef ARDUINO_ARCH_ESP32
#if !ARDUINO_USB_CDC_ON_BOOT
  Serial.setRxBufferSize(1024);
  Serial.setTxBufferSize(1024);
#endif
  Wire.begin(PIN_SDA, PIN_SCL, I2C_HZ);
  Wire.setTimeOut(I2C_TIMEOUT_MS);
  enableLoopWDT();
#else
  analogReadResolution(12);
  Wire.setSDA(PIN_SDA);
  Wire.setSCL(PIN_SCL);
  Wire.setClock(I2C_HZ);
  Wire.begin();
  Wire.setTimeout(I2C_TIMEOUT_MS);
  rp2040.wdt_begin(WATCHDOG_MS);
#endif
  Serial.begin(BAUD);
#ifdef SIGNING_KEY
  settings.key = KEY;
#endif
  board.begin();
  board.set_fault(check_boards());
  tick_at = now_us();
}

void loop() {
#ifdef ARDUINO_ARCH_RP2040
  rp2040.wdt_reset();
#endif
  const uint64_t now = now_us();
  uint8_t bytes[256];
  size_t length = 0;
  while (length < sizeof bytes && Serial.available() > 0) bytes[length++] = Serial.read();
  board.receive(bytes, length, now);
  if (now >= tick_at) {
    tick_at = now - tick_at < PERIOD_US ? tick_at + PERIOD_US : now + PERIOD_US;
    if (ticks++ % CHECK_TICKS == 0) board.set_fault(check_boards());
    sense();
    board.tick(now);
    if (!written) revision = board.revision() - 1;  // try again
  }
  if (revision != board.revision()) move_servos();
}
