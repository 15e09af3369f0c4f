// Random bytes, damaged, cut, repeated and random frames for the board's logic: fuzz SEED INPUTS. Built with sanitizers.
//
// It aborts if a pulse leaves its limits, a servo moves without a command, a silence does not release, or a frame that
// is sent is none.
#include <stdio.h>
#include <stdlib.h>

#include <string>

#include "board.h"

using namespace hexctl;

static uint64_t state;

static uint32_t below(uint32_t count) {
  state ^= state << 13;
  state ^= state >> 7;
  state ^= state << 17;
  return static_cast<uint32_t>(state >> 16) % count;
}

#define CHECK(condition) \
  if (!(condition)) {    \
    printf("input %ld: %s\n", input, #condition); \
    abort();             \
  }

static long input;
static Settings settings(600, 2400, 1500);

class Checked : public Line {
 public:
  long sent = 0;

  bool send(const uint8_t *frame, size_t length) override {
    if (below(50) == 0) return false;
    ++sent;
    mavlink_message_t message;
    mavlink_status_t status;
    uint8_t found = 0;
    for (size_t each = 0; each < length; ++each) {
      found = mavlink_frame_char_buffer(&parsing_, &status_, frame[each], &message, &status);
    }
    CHECK(found == MAVLINK_FRAMING_OK);
    if (message.msgid == MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS) {
      mavlink_actuator_output_status_t outputs;
      mavlink_msg_actuator_output_status_decode(&message, &outputs);
      CHECK(outputs.active < 1u << CHANNELS && outputs.time_usec > 0);
      for (int channel = 0; channel < CHANNELS; ++channel) {
        CHECK(outputs.actuator[channel] >= 600 && outputs.actuator[channel] <= 2400);
      }
    }
    return true;
  }

 private:
  mavlink_message_t parsing_ = {};
  mavlink_status_t status_ = {};
};

static const uint32_t KINDS[] = {0, 1, 4, 20, 21, 23, 40, 43, 44, 45, 51, 69, 70, 70, 75, 76, 77, 110, 253, 375};

// A frame with a right checksum and a payload of random length; overrides mostly have possible pulses.
static std::string frame(bool overrides, uint64_t now) {
  mavlink_message_t message = {};
  uint8_t payload[255];
  message.msgid = below(2) ? 70 : KINDS[below(sizeof KINDS / sizeof *KINDS)];
  if (!overrides && message.msgid == 70) message.msgid = 0;
  for (uint8_t &byte : payload) byte = below(256);
  uint8_t length = 1 + below(255);
  if (message.msgid == 70 && below(4)) {
    uint16_t pulses[19];
    for (uint16_t &pulse : pulses) pulse = below(20) ? 100 + below(4901) : below(2) ? 65534 + below(2) : 0;
    memcpy(payload, pulses, 38);
    memmove(payload + 18, payload + 16, 20);
    payload[16] = payload[17] = below(3) == 0;
    length = 38;
  } else if (message.msgid == 0 && below(2)) {
    const uint32_t echo = static_cast<uint32_t>(now / 1000) - below(400);
    memcpy(payload, &echo, 4);
    payload[7] = below(8);
    length = 9;
  }
  memcpy(_MAV_PAYLOAD_NON_CONST(&message), payload, length);
  static mavlink_status_t senders[256] = {};
  const uint8_t system = below(20) ? 255 : below(3) ? 254 : below(256);
  if (below(200) == 0) senders[system].current_tx_seq = below(256);
  mavlink_finalize_message_buffer(&message, system, 191, &senders[system], length, length,
                                  mavlink_get_crc_extra(&message));
  uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
  return std::string(reinterpret_cast<char *>(bytes), mavlink_msg_to_send_buffer(bytes, &message));
}

static std::string some(bool overrides, uint64_t now) {
  std::string bytes;
  switch (below(6)) {
    case 0:
      for (uint32_t left = below(300); left; --left) bytes += static_cast<char>(below(4) ? below(256) : 0xFD);
      return bytes;
    case 1:
      bytes = frame(overrides, now);
      return bytes.substr(0, below(bytes.size()));
    case 2:
      bytes = frame(overrides, now);
      bytes[below(bytes.size())] ^= 1 << below(8);
      return bytes;
    case 3: {
      const std::string one = frame(overrides, now);
      for (uint32_t left = 1 + below(40); left; --left) bytes += one;
      return bytes;
    }
    default:
      return frame(overrides, now);
  }
}

int main(int, char **arguments) {
  state = 88172645463325252ull ^ strtoull(arguments[1], nullptr, 10) << 20;
  const long inputs = atol(arguments[2]);
  Checked line;
  uint64_t now = 1000000, silent_since = now;
  Board board(settings, line);
  board.begin();
  for (input = 0; input < inputs; ++input) {
    const bool overrides = input >= inputs / 10;  // at first there are none
    const bool pause = below(200) == 0;
    const uint64_t until = now + (pause ? below(12000000) : below(10000));
    if (!pause) {
      const std::string bytes = some(overrides, now);
      board.receive(reinterpret_cast<const uint8_t *>(bytes.data()), bytes.size(), now);
      silent_since = now;
    }
    for (; now <= until; now += PERIOD_US) {
      board.set_contacts(below(64));
      board.set_battery(below(65536));
      board.set_fault(below(500) ? nullptr : "a fault with far more letters than fifty, which are all that fit into it");
      board.tick(now);
      CHECK(now - silent_since <= settings.release_us || !board.driven());
    }
    now = until + 1;
    CHECK(overrides || (!board.driven() && board.revision() == 0));
    for (int channel = 0; channel < CHANNELS; ++channel) {
      const uint16_t pulse = board.pulse(channel);
      CHECK(pulse == 0 || (pulse >= 600 && pulse <= 2400));
    }
  }
  const Counters &counts = board.counters();
  printf("%ld inputs, %u executed, %u malformed, %u refused, %u expired, %u released, %ld sent\n", inputs,
         counts.overrides, counts.malformed, counts.refused, counts.expired, counts.released, line.sent);
  return counts.overrides && counts.malformed && counts.expired && counts.released ? 0 : 1;
}
