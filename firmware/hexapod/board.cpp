#include "board.h"

#include <string.h>

namespace hexctl {

namespace {

constexpr uint8_t SYSTEM = 1, COMPONENT = MAV_COMP_ID_AUTOPILOT1;

// Values of an override: leave the channel, or release it (1..8, and 9..18, for which 0 is "not commanded").
constexpr uint16_t IGNORE = 65535, RELEASE_LOW = 0, RELEASE_HIGH = 65534;
constexpr int FIRST_HIGH = 8;

// Pulses outside make an override invalid.
constexpr uint16_t LEAST_US = 100, MOST_US = 5000;

// A peer keeps its place for so long without showing that it receives states, and so long after it has.
constexpr uint64_t PROVE_US = 500000, FREE_AFTER_US = 2500000;

// A peer is dropped after this silence; after a shorter one its next sequence number is not compared.
constexpr uint64_t FORGET_US = 5000000, RESTARTED_US = 500000;

constexpr uint64_t REFUSAL_PERIOD_US = 1000000;
constexpr uint32_t BEAT_TICKS = 50;

const char PARAMETER[] = "CHANNELS";
constexpr int16_t BY_NAME = -1;  // index of a parameter that is requested by name

constexpr uint32_t ALL = (1u << CHANNELS) - 1;

// Channels that an override releases or drives, one bit each.
struct Sorted {
  uint32_t released = 0, driven = 0;

  explicit Sorted(const uint16_t *raw) {
    for (int channel = 0; channel < CHANNELS; ++channel) {
      const bool high = channel >= FIRST_HIGH;
      const uint16_t value = raw[channel];
      if (value == (high ? RELEASE_HIGH : RELEASE_LOW)) {
        released |= 1u << channel;
      } else if (value != IGNORE && !(high && value == 0)) {  // MAVLink truncates trailing zeros
        driven |= 1u << channel;
      }
    }
  }

  uint32_t left(uint32_t active) const { return (active & ~released) | driven; }
};

void channels_of(const mavlink_message_t &message, uint16_t *raw) {
  mavlink_rc_channels_override_t given;
  mavlink_msg_rc_channels_override_decode(&message, &given);
  const uint16_t values[CHANNELS] = {
      given.chan1_raw,  given.chan2_raw,  given.chan3_raw,  given.chan4_raw,  given.chan5_raw,  given.chan6_raw,
      given.chan7_raw,  given.chan8_raw,  given.chan9_raw,  given.chan10_raw, given.chan11_raw, given.chan12_raw,
      given.chan13_raw, given.chan14_raw, given.chan15_raw, given.chan16_raw, given.chan17_raw, given.chan18_raw};
  memcpy(raw, values, sizeof values);
}

bool for_us(uint8_t system, uint8_t component) {
  return (system == 0 || system == SYSTEM) && (component == 0 || component == COMPONENT);
}

}  // namespace

Settings::Settings(uint16_t least, uint16_t most, uint16_t start) {
  for (int channel = 0; channel < CHANNELS; ++channel) {
    least_us[channel] = least;
    most_us[channel] = most;
    start_us[channel] = start;
  }
}

bool Parser::next(mavlink_message_t &message, uint32_t &malformed) {
  while (at_ < length_) {
    const uint8_t byte = bytes_[at_++];
    if (at_ == 1 && byte != MAVLINK_STX) {  // noise, or MAVLink 1
      skip(malformed);
      continue;
    }
    switch (mavlink_frame_char_buffer(&parsing_, &status_, byte, &message, nullptr)) {
      case MAVLINK_FRAMING_OK:
        // A peer that signs expects signatures: accepting its frames would look like a working link.
        if (status_.signing == nullptr && (message.incompat_flags & MAVLINK_IFLAG_SIGNED)) {
          skip(malformed);
          break;
        }
        memmove(bytes_, bytes_ + at_, length_ - at_);
        length_ -= at_;
        at_ = 0;
        in_garbage_ = false;
        return true;
      case MAVLINK_FRAMING_INCOMPLETE:
        if (status_.parse_state == MAVLINK_PARSE_STATE_IDLE) skip(malformed);  // an unknown flag
        break;
      default:
        skip(malformed);
    }
  }
  return false;
}

// Drop the first byte, and parse the others again.
void Parser::skip(uint32_t &malformed) {
  if (!in_garbage_) ++malformed;
  in_garbage_ = true;
  uint16_t start = 1;
  while (start < length_ && bytes_[start] != MAVLINK_STX) ++start;
  memmove(bytes_, bytes_ + start, length_ - start);
  length_ -= start;
  at_ = 0;
  status_.parse_state = MAVLINK_PARSE_STATE_IDLE;
}

void Board::begin() {
  memcpy(pulses_, settings_.start_us, sizeof pulses_);
  if (settings_.key != nullptr) {
    memcpy(signing_.secret_key, settings_.key, sizeof signing_.secret_key);
    signing_.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    status_.signing = &signing_;
    status_.signing_streams = &streams_;
  }
}

void Board::receive(const uint8_t *bytes, size_t length, uint64_t now) {
  watch(now);  // first: if the board stood still, what waited in the line is old
  for (size_t each = 0; each < length; ++each) {
    parser_.put(bytes[each]);
    while (parser_.next(received_, counters_.malformed)) handle(received_, now);
  }
}

void Board::tick(uint64_t now) {
  watch(now);
  if (now - heard_ > settings_.release_us) {
    if (active_) release();
    commander_ = nullptr;
  }
  report(now);
}

void Board::report(uint64_t now) {
  if (ticks_++ % BEAT_TICKS == 0 || fault_ != reported_) {
    introduce(now);
    mavlink_sys_status_t health = {};
    health.voltage_battery = battery_mv_;
    health.current_battery = health.battery_remaining = -1;
    health.errors_comm = counters_.malformed < 65535 ? counters_.malformed : 65535;
    send(mavlink_msg_sys_status_encode_status, health);
  }
  alignas(8) mavlink_actuator_output_status_t outputs = {};
  outputs.time_usec = now ? now : 1;  // zero is no time
  outputs.active = active_;
  for (int channel = 0; channel < CHANNELS; ++channel) outputs.actuator[channel] = pulses_[channel];
  send(mavlink_msg_actuator_output_status_encode_status, outputs);
  if (has_contacts_) {
    mavlink_named_value_int_t contacts = {};
    contacts.time_boot_ms = now / 1000;
    strcpy(contacts.name, "contacts");
    contacts.value = contacts_;
    send(mavlink_msg_named_value_int_encode_status, contacts);
  }
}

void Board::set_contacts(uint8_t feet) {
  contacts_ = feet;
  has_contacts_ = true;
}

void Board::stop() {
  if (active_) release();
  stopped_ = true;
}

// Hold the pose after a silence, or end a stop.
void Board::watch(uint64_t now) {
  if (stopped_ && now - overridden_ > settings_.expiry_us) stopped_ = false;
  if (active_ && !expired_ && now - executed_ > settings_.expiry_us) {
    expired_ = true;
    ++counters_.expired;
  }
}

void Board::handle(const mavlink_message_t &message, uint64_t now) {
  bool is_new = false;
  Peer *peer = hear(message, now, is_new);
  if (peer == nullptr || !in_order(*peer, message.seq, now)) return;
  if (is_new) introduce(now);
  if (peer == commander_) heard_ = now;
  if (message.msgid == MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE) {
    override_channels(message, *peer, now);
  } else if (message.msgid == MAVLINK_MSG_ID_HEARTBEAT) {
    beat(message, *peer, now);
  } else {
    answer(message, *peer);
  }
}

// The peer that sent a frame, or nullptr while it has to wait for a place. Whoever commands or receives keeps its own.
Peer *Board::hear(const mavlink_message_t &message, uint64_t now, bool &is_new) {
  Peer *place = nullptr;  // a free one, or that of whoever may be dropped first
  uint64_t least = UINT64_MAX;
  for (Peer &peer : peers_) {
    if (peer.used && &peer != commander_ && now - peer.heard > FORGET_US) peer.used = false;
    if (peer.used && peer.system == message.sysid && peer.component == message.compid) {
      peer.heard = now;
      return &peer;
    }
  }
  for (Peer &peer : peers_) {
    if (&peer == commander_) continue;
    uint64_t keeps = peer.used ? peer.since + PROVE_US : 0;
    if (peer.used && peer.present && peer.present + FREE_AFTER_US > keeps) keeps = peer.present + FREE_AFTER_US;
    if (keeps < least) {
      least = keeps;
      place = &peer;
    }
  }
  if (least > 0 && now <= least) {
    ++counters_.crowded_out;
    return nullptr;
  }
  *place = Peer();
  place->used = is_new = true;
  place->system = message.sysid;
  place->component = message.compid;
  place->since = place->heard = now;
  return place;
}

// Whether a frame is newer than all before it; sequence numbers count modulo 256.
bool Board::in_order(Peer &peer, uint8_t sequence, uint64_t now) {
  const bool compared = peer.numbered && now - peer.numbered_at <= RESTARTED_US;
  const uint8_t ahead = compared ? sequence - peer.newest : 1;
  if (ahead == 0 || ahead >= 128) {
    ++counters_.out_of_order;
    if (ahead && counters_.lost) --counters_.lost;  // it was counted as lost when its successor arrived
    return false;
  }
  counters_.lost += ahead - 1;
  peer.newest = sequence;
  peer.numbered = true;
  peer.numbered_at = now;
  return true;
}

void Board::beat(const mavlink_message_t &message, Peer &peer, uint64_t now) {
  mavlink_heartbeat_t given;
  mavlink_msg_heartbeat_decode(&message, &given);
  if (given.system_status == MAV_STATE_POWEROFF) {
    peer.used = false;
    if (&peer == commander_) commander_ = nullptr;
  } else if (given.custom_mode != 0) {
    const uint32_t age_ms = static_cast<uint32_t>(now / 1000) - given.custom_mode;
    if (age_ms <= settings_.expiry_us / 1000) peer.present = now;
  }
}

void Board::override_channels(const mavlink_message_t &message, Peer &peer, uint64_t now) {
  if (!for_us(mavlink_msg_rc_channels_override_get_target_system(&message),
              mavlink_msg_rc_channels_override_get_target_component(&message))) {
    return;
  }
  if (commander_ != nullptr && commander_ != &peer && now - commander_->heard <= FREE_AFTER_US) {
    refuse(peer, now);
    return;
  }
  if (commander_ != &peer) {
    commander_ = &peer;
    streaming_ = false;
  }
  heard_ = now;
  if (!streaming_ || now - overridden_ > settings_.expiry_us) stream_since_ = now;
  streaming_ = true;
  overridden_ = now;

  uint16_t raw[CHANNELS];
  channels_of(message, raw);
  const uint32_t left = Sorted(raw).left(active_);
  if (!counts(peer, left, now)) {
    ++counters_.not_yet;
  } else if (!take(raw, left)) {
    ++counters_.refused;
  } else {
    executed_ = now;
    expired_ = false;
    ++counters_.overrides;
  }
}

void Board::refuse(Peer &peer, uint64_t now) {
  ++counters_.of_others;
  if (peer.refused == 0 || now - peer.refused > REFUSAL_PERIOD_US) {
    peer.refused = now;
    say("another controller holds the servos");
  }
}

// Whether an override counts that leaves these channels driven: after a silence it may be late.
bool Board::counts(const Peer &peer, uint32_t left, uint64_t now) const {
  const bool present = peer.present && now - peer.present <= settings_.expiry_us;
  const bool steady = now - stream_since_ >= settings_.expiry_us + settings_.expiry_us / 2;
  return left == 0 || (!stopped_ && (!expired_ || present || steady));
}

// Apply an override to all channels or none; false for an impossible pulse.
bool Board::take(const uint16_t *raw, uint32_t left) {
  const uint32_t driven = Sorted(raw).driven;
  bool clipped = false;
  uint16_t pulses[CHANNELS];
  memcpy(pulses, pulses_, sizeof pulses);
  for (int channel = 0; channel < CHANNELS; ++channel) {
    if (!(driven >> channel & 1)) continue;
    if (raw[channel] < LEAST_US || raw[channel] > MOST_US) return false;
    const uint16_t least = settings_.least_us[channel], most = settings_.most_us[channel];
    pulses[channel] = raw[channel] < least ? least : raw[channel] > most ? most : raw[channel];
    clipped |= pulses[channel] != raw[channel];
  }
  counters_.clipped += clipped;
  memcpy(pulses_, pulses, sizeof pulses_);
  active_ = left & ALL;
  ++revision_;
  if (!active_) ++counters_.released;
  return true;
}

void Board::release() {
  active_ = 0;
  ++revision_;
  ++counters_.released;
}

void Board::introduce(uint64_t now) {
  mavlink_heartbeat_t beat = {};
  beat.type = MAV_TYPE_GENERIC;
  beat.autopilot = MAV_AUTOPILOT_INVALID;
  beat.mavlink_version = 3;
  beat.system_status = fault_ != nullptr ? MAV_STATE_EMERGENCY
                       : expired_        ? MAV_STATE_CRITICAL
                       : active_         ? MAV_STATE_ACTIVE
                                         : MAV_STATE_STANDBY;
  send(mavlink_msg_heartbeat_encode_status, beat);
  mavlink_named_value_int_t measured = {};
  measured.time_boot_ms = now / 1000;
  strcpy(measured.name, "measured");  // value 0: positions are an echo
  send(mavlink_msg_named_value_int_encode_status, measured);
  if (fault_ != nullptr) say(fault_);
  reported_ = fault_;
}

void Board::say(const char *text) {
  mavlink_statustext_t words = {};
  words.severity = MAV_SEVERITY_CRITICAL;
  strncpy(words.text, text, sizeof words.text - 1);
  send(mavlink_msg_statustext_encode_status, words);
}

template <typename Fields>
void Board::send(Encode<Fields> *encode, const Fields &fields) {
  uint8_t frame[MAVLINK_MAX_PACKET_LEN];
  encode(SYSTEM, COMPONENT, &status_, &sent_, &fields);
  if (!line_.send(frame, mavlink_msg_to_send_buffer(frame, &sent_))) ++counters_.dropped;
}

// Ground stations repeat unanswered requests for many seconds. The board has one constant parameter, no mission and
// no files (https://mavlink.io/en/services/).
void Board::answer(const mavlink_message_t &message, const Peer &peer) {
  if (message.msgid == MAVLINK_MSG_ID_PING) {
    mavlink_ping_t ping;
    mavlink_msg_ping_decode(&message, &ping);
    if (ping.target_system || ping.target_component) return;
    ping.target_system = peer.system;
    ping.target_component = peer.component;
    send(mavlink_msg_ping_encode_status, ping);
    return;
  }
  const mavlink_msg_entry_t *entry = mavlink_get_msg_entry(message.msgid);
  if (entry == nullptr || !(entry->flags & MAV_MSG_ENTRY_FLAG_HAVE_TARGET_COMPONENT)) return;
  const uint8_t *payload = reinterpret_cast<const uint8_t *>(_MAV_PAYLOAD(&message));
  if (!for_us(payload[entry->target_system_ofs], payload[entry->target_component_ofs])) return;

  char name[17] = {};
  switch (message.msgid) {
    case MAVLINK_MSG_ID_COMMAND_LONG:
      return answer_command(mavlink_msg_command_long_get_command(&message),
                            mavlink_msg_command_long_get_param1(&message), peer);
    case MAVLINK_MSG_ID_COMMAND_INT:
      return answer_command(mavlink_msg_command_int_get_command(&message),
                            mavlink_msg_command_int_get_param1(&message), peer);
    case MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
      return answer_parameter(PARAMETER, BY_NAME, peer);
    case MAVLINK_MSG_ID_PARAM_REQUEST_READ:
      mavlink_msg_param_request_read_get_param_id(&message, name);
      return answer_parameter(name, mavlink_msg_param_request_read_get_param_index(&message), peer);
    case MAVLINK_MSG_ID_PARAM_SET:
      mavlink_msg_param_set_get_param_id(&message, name);
      return answer_parameter(name, BY_NAME, peer);
    case MAVLINK_MSG_ID_MISSION_REQUEST_LIST: {
      mavlink_mission_count_t none = {};
      none.target_system = peer.system;
      none.target_component = peer.component;
      none.mission_type = mavlink_msg_mission_request_list_get_mission_type(&message);
      return send(mavlink_msg_mission_count_encode_status, none);
    }
    case MAVLINK_MSG_ID_MISSION_COUNT:
      return answer_mission(mavlink_msg_mission_count_get_mission_type(&message), peer);
    case MAVLINK_MSG_ID_MISSION_REQUEST:
      return answer_mission(mavlink_msg_mission_request_get_mission_type(&message), peer);
    case MAVLINK_MSG_ID_MISSION_REQUEST_INT:
      return answer_mission(mavlink_msg_mission_request_int_get_mission_type(&message), peer);
    case MAVLINK_MSG_ID_MISSION_CLEAR_ALL:
      return answer_mission(mavlink_msg_mission_clear_all_get_mission_type(&message), peer);
    case MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL:
      return answer_files(message, peer);
    default:
      return;
  }
}

void Board::answer_command(uint16_t command, float parameter, const Peer &peer) {
  const bool version =
      command == MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES ||
      (command == MAV_CMD_REQUEST_MESSAGE && parameter == static_cast<float>(MAVLINK_MSG_ID_AUTOPILOT_VERSION));
  mavlink_command_ack_t ack = {};
  ack.command = command;
  ack.result = version ? MAV_RESULT_ACCEPTED : MAV_RESULT_UNSUPPORTED;
  ack.target_system = peer.system;
  ack.target_component = peer.component;
  send(mavlink_msg_command_ack_encode_status, ack);
  if (!version) return;
  mavlink_autopilot_version_t about = {};
  about.capabilities = MAV_PROTOCOL_CAPABILITY_MAVLINK2;
  send(mavlink_msg_autopilot_version_encode_status, about);
}

// The one parameter, by its name or its index; or that there is no other.
void Board::answer_parameter(const char *name, int16_t index, const Peer &peer) {
  if (index == BY_NAME ? strcmp(name, PARAMETER) == 0 : index == 0) {
    mavlink_param_value_t value = {};
    strcpy(value.param_id, PARAMETER);
    value.param_value = CHANNELS;
    value.param_type = MAV_PARAM_TYPE_REAL32;
    value.param_count = 1;
    return send(mavlink_msg_param_value_encode_status, value);
  }
  mavlink_param_error_t error = {};
  error.target_system = peer.system;
  error.target_component = peer.component;
  memcpy(error.param_id, name, strnlen(name, sizeof error.param_id));
  error.param_index = index;
  error.error = MAV_PARAM_ERROR_DOES_NOT_EXIST;
  send(mavlink_msg_param_error_encode_status, error);
}

void Board::answer_mission(uint8_t type, const Peer &peer) {
  mavlink_mission_ack_t ack = {};
  ack.target_system = peer.system;
  ack.target_component = peer.component;
  ack.type = MAV_MISSION_UNSUPPORTED;
  ack.mission_type = type;
  send(mavlink_msg_mission_ack_encode_status, ack);
}

// That there are no files (https://mavlink.io/en/services/ftp.html): 16 bits of sequence, then a byte each for
// session, opcode, size and requested opcode; data begin at 12.
void Board::answer_files(const mavlink_message_t &message, const Peer &peer) {
  constexpr uint8_t ACK = 128, NAK = 129, UNKNOWN_COMMAND = 7;
  mavlink_file_transfer_protocol_t asked;
  mavlink_msg_file_transfer_protocol_decode(&message, &asked);
  if (asked.payload[3] == ACK || asked.payload[3] == NAK) return;  // itself an answer
  const uint16_t sequence = (asked.payload[0] | asked.payload[1] << 8) + 1;
  mavlink_file_transfer_protocol_t answer = {};
  answer.target_system = peer.system;
  answer.target_component = peer.component;
  answer.payload[0] = sequence & 255;
  answer.payload[1] = sequence >> 8;
  answer.payload[2] = asked.payload[2];
  answer.payload[3] = NAK;
  answer.payload[4] = 1;
  answer.payload[5] = asked.payload[3];
  answer.payload[12] = UNKNOWN_COMMAND;
  send(mavlink_msg_file_transfer_protocol_encode_status, answer);
}

}  // namespace hexctl
