// A servo board that meets hexctl's MAVLink contract (docs/reference/mavlink.md): 18 pulses, their watchdog, reports.
//
// Pure logic: it needs neither Arduino nor a clock, so that the same code runs on the board and in tests. Times are
// microseconds since start, in 64 bits.
#pragma once

#include <stddef.h>
#include <stdint.h>

// Fields are copied byte by byte: the processor of an RP2040 reads no unaligned words.
#define MAVLINK_ALIGNED_FIELDS 0
#include "src/mavlink/common/mavlink.h"

namespace hexctl {

constexpr int CHANNELS = 18;
constexpr int LEGS = 6;
constexpr uint16_t UNKNOWN_MV = 65535;

// Period of Board::tick.
constexpr uint32_t PERIOD_US = 20000;

// Limits and times of a board.
struct Settings {
  uint16_t least_us[CHANNELS];  // shortest and longest pulse of each channel, which no command exceeds
  uint16_t most_us[CHANNELS];
  uint16_t start_us[CHANNELS];  // pulses that it reports before the first command
  uint32_t expiry_us = 200000;  // without an override: hold
  uint32_t release_us = 10000000;  // without any frame of the commander: limp
  const uint8_t *key = nullptr;  // 32 bytes that sign all frames, or none

  Settings(uint16_t least, uint16_t most, uint16_t start);
};

// The line to the controller.
class Line {
 public:
  // Send a complete frame; false, with nothing sent, if there is no room for it.
  virtual bool send(const uint8_t *frame, size_t length) = 0;

 protected:
  ~Line() = default;
};

// Counts since start.
struct Counters {
  uint32_t overrides = 0;     // executed
  uint32_t refused = 0;       // with an impossible pulse
  uint32_t of_others = 0;     // while another controller commands
  uint32_t not_yet = 0;       // after a silence, maybe late
  uint32_t expired = 0;       // poses held
  uint32_t released = 0;      // times that all servos went limp
  uint32_t clipped = 0;       // overrides that a limit changed
  uint32_t lost = 0;          // frames that never arrived
  uint32_t out_of_order = 0;  // frames late or twice
  uint32_t crowded_out = 0;   // frames of senders without a place
  uint32_t malformed = 0;     // runs of bytes that are no frame
  uint32_t dropped = 0;       // frames that the line could not take
};

// Finds frames in bytes with MAVLink's own parser. A wrong checksum costs only the first byte, so that garbage cannot
// hide a good frame.
class Parser {
 public:
  explicit Parser(mavlink_status_t &status) : status_(status) {}

  // Take a byte; call next until it returns false, and then the next one.
  void put(uint8_t byte) { bytes_[length_++] = byte; }

  // The next frame of the bytes so far; false if none is complete.
  bool next(mavlink_message_t &message, uint32_t &malformed);

 private:
  void skip(uint32_t &malformed);

  mavlink_status_t &status_;
  mavlink_message_t parsing_ = {};
  uint8_t bytes_[MAVLINK_MAX_PACKET_LEN + 1];
  uint16_t length_ = 0;  // bytes of an unfinished frame
  uint16_t at_ = 0;      // how many of them were parsed
  bool in_garbage_ = false;
};

// A MAVLink system that sends to the board.
struct Peer {
  bool used = false;
  uint8_t system = 0, component = 0;
  uint8_t newest = 0;         // its highest sequence number
  bool numbered = false;      // whether it has one
  uint64_t numbered_at = 0;   // and since when
  uint64_t since = 0, heard = 0;
  uint64_t refused = 0;       // when it was last informed that another one commands
  uint64_t present = 0;       // when it last showed that it receives the states of now; 0 is never
};

class Board {
 public:
  // Settings and line must outlive the board.
  Board(const Settings &settings, Line &line) : settings_(settings), line_(line), parser_(status_) {}
  Board(const Board &) = delete;
  Board &operator=(const Board &) = delete;

  // Begin with the settings as they are now.
  void begin();

  // Take bytes that arrived; call it as soon as there are some.
  void receive(const uint8_t *bytes, size_t length, uint64_t now);

  // Watch for silence and report; call it every PERIOD_US.
  void tick(uint64_t now);

  // Pulse of a channel, 0 to 17, or 0 if it is not driven; and whether any is.
  uint16_t pulse(int channel) const { return active_ >> channel & 1 ? pulses_[channel] : 0; }
  bool driven() const { return active_ != 0; }

  // Changes with each command and release.
  uint32_t revision() const { return revision_; }

  // Release all servos until overrides pause for `expiry_us`: a controller that goes on would move them again.
  void stop();
  bool stopped() const { return stopped_; }

  // What the board measures, from its sketch: battery, and switches at the feet (one bit per leg).
  void set_battery(uint16_t millivolts) { battery_mv_ = millivolts; }
  void set_contacts(uint8_t feet);

  // A fault that stops the controller while it lasts, in up to 50 letters; nullptr for none.
  void set_fault(const char *text) { fault_ = text; }

  const Counters &counters() const { return counters_; }

 private:
  static constexpr int MOST_PEERS = 8;

  void watch(uint64_t now);
  void handle(const mavlink_message_t &message, uint64_t now);
  Peer *hear(const mavlink_message_t &message, uint64_t now, bool &is_new);
  bool in_order(Peer &peer, uint8_t sequence, uint64_t now);
  void beat(const mavlink_message_t &message, Peer &peer, uint64_t now);
  void override_channels(const mavlink_message_t &message, Peer &peer, uint64_t now);
  void refuse(Peer &peer, uint64_t now);
  bool counts(const Peer &peer, uint32_t left, uint64_t now) const;
  bool take(const uint16_t *raw, uint32_t left);
  void release();
  void answer(const mavlink_message_t &message, const Peer &peer);
  void answer_command(uint16_t command, float parameter, const Peer &peer);
  void answer_parameter(const char *name, int16_t index, const Peer &peer);
  void answer_files(const mavlink_message_t &message, const Peer &peer);
  void answer_mission(uint8_t type, const Peer &peer);
  void introduce(uint64_t now);
  void report(uint64_t now);
  void say(const char *text);

  template <typename Fields>
  using Encode = uint16_t(uint8_t, uint8_t, mavlink_status_t *, mavlink_message_t *, const Fields *);
  template <typename Fields>
  void send(Encode<Fields> *encode, const Fields &fields);

  const Settings &settings_;
  Line &line_;
  Counters counters_;
  mavlink_status_t status_ = {};
  mavlink_signing_t signing_ = {};
  mavlink_signing_streams_t streams_ = {};
  Parser parser_;
  mavlink_message_t received_ = {}, sent_ = {};

  Peer peers_[MOST_PEERS];
  Peer *commander_ = nullptr;
  uint64_t heard_ = 0;           // last frame of the commander
  uint64_t overridden_ = 0;      // its last override
  uint64_t executed_ = 0;        // the last one that was executed
  uint64_t stream_since_ = 0;    // since when overrides have come without a silence
  bool streaming_ = false;       // whether any came
  bool expired_ = false;         // a silence holds the pose
  bool stopped_ = false;         // overrides are refused until they pause

  uint16_t pulses_[CHANNELS];
  uint32_t active_ = 0;          // one bit per driven channel
  uint32_t revision_ = 0;

  uint32_t ticks_ = 0;
  uint16_t battery_mv_ = UNKNOWN_MV;
  uint8_t contacts_ = 0;
  bool has_contacts_ = false;
  const char *fault_ = nullptr, *reported_ = nullptr;
};

}  // namespace hexctl
