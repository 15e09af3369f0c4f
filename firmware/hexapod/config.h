// Your wiring, and the limits of your servos: change it before you compile.
#pragma once

// Wires of the two PCA9685 boards, and of their OE inputs, each pulled up by 10 kilohms to 3.3 V.
#if defined(ARDUINO_ARCH_ESP32)
#define PIN_SDA 21
#define PIN_SCL 22
#define PIN_OE 23
#elif defined(ARDUINO_ARCH_RP2040)
#define PIN_SDA 4
#define PIN_SCL 5
#define PIN_OE 6
#else
#error "This sketch knows the pins of ESP32 and RP2040; add those of your board"
#endif

// Analog input of the battery's divider, and how much that divides: 30 and 10 kilohms by 4. -1: not connected.
#ifndef PIN_BATTERY
#define PIN_BATTERY -1
#endif
#define BATTERY_DIVIDER 4

// A switch to ground at the foot of legs 1 to 6. -1: not connected; the contacts are reported if all six are.
#ifndef PINS_FEET
#define PINS_FEET {-1, -1, -1, -1, -1, -1}
#endif

// Addresses of the boards for channels 1 to 9 (legs 1 to 3) and 10 to 18 (legs 4 to 6), on outputs 0 to 8 of each.
#define SERVO_BOARDS {0x40, 0x41}

// Frequency of their oscillators. If a pulse of 1500 us is 2 % too long, enter 2 % less.
#define OSCILLATOR_HZ 25000000

// For all channels in microseconds: pulses that no command exceeds, and the one reported before the first command.
#define LEAST_US 500
#define MOST_US 2500
#define START_US 1500

// To accept signed frames only: the 32 bytes of mavlink.key (hexctl keys mavlink FOLDER).
// #define SIGNING_KEY {0x12, 0x34, ...}

// Bits per second of a serial line; USB ignores it.
#define BAUD 115200
