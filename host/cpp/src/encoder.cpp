#include "ruffini/client/encoder.h"

#include "framing.h"

namespace ruffini::client {
namespace {

void put_varint(Bytes& out, uint64_t v) {
  for (; v > 127; v >>= 7) out.push_back(static_cast<uint8_t>(v | 128));
  out.push_back(static_cast<uint8_t>(v));
}

void put_number(Bytes& out, uint32_t field, uint64_t v) {
  if (v == 0) return;  // proto3 sends no zeros
  put_varint(out, uint64_t{field} << 3);
  put_varint(out, v);
}

void put_message(Bytes& out, uint32_t field, const Bytes& message) {
  put_varint(out, uint64_t{field} << 3 | 2);
  put_varint(out, message.size());
  out.insert(out.end(), message.begin(), message.end());
}

}  // namespace

Bytes Encoder::ask_hello() {
  Bytes out = {0};
  const Bytes said = frame(Type::kHello, {}, kDevice);
  out.insert(out.end(), said.begin(), said.end());
  return out;
}

Bytes Encoder::ask_status() { return frame(Type::kStatus, {}, kDevice); }

Bytes Encoder::ask_time(uint64_t token) {
  Bytes payload;
  put_number(payload, 1, token);
  return frame(Type::kTime, payload, kDevice);
}

Bytes Encoder::subscribe(const std::vector<std::pair<Type, uint32_t>>& every) {
  Bytes list;
  for (const auto& [type, n] : every) {
    Bytes one;
    put_number(one, 1, static_cast<uint8_t>(type));
    put_number(one, 2, n);
    put_message(list, 1, one);
  }
  Bytes action;
  put_message(action, 2, list);
  return command(action, kDevice);
}

Bytes Encoder::zero(uint32_t n_frames, bool even_if_touched, uint8_t sensor) {
  Bytes zero, action;
  put_number(zero, 1, n_frames);
  put_number(zero, 2, even_if_touched ? 1 : 0);
  put_message(action, 3, zero);
  return command(action, sensor);
}

Bytes Encoder::command(const Bytes& action, uint8_t sensor) {
  if (++request_id_ == 0) request_id_ = 1;  // 0 is the device's own
  Bytes payload;
  put_number(payload, 1, request_id_);
  payload.insert(payload.end(), action.begin(), action.end());
  put_number(payload, 60, holder_);
  return frame(Type::kCommand, payload, sensor);
}

// Every message of a host fits one frame.
Bytes Encoder::frame(Type type, const Bytes& payload, uint8_t sensor) {
  Bytes plain = {kProtocolVersion, kFromHost, static_cast<uint8_t>(type), sensor};
  put_u32(plain, sequence_++);
  plain.insert(plain.end(), {0, 1, static_cast<uint8_t>(payload.size()), static_cast<uint8_t>(payload.size() >> 8)});
  plain.insert(plain.end(), payload.begin(), payload.end());
  put_u32(plain, crc32c(plain.data(), plain.size()));
  Bytes out = cobs_encode(plain);
  out.push_back(0);
  return out;
}

}  // namespace ruffini::client
