#include "sim_line.h"

#include <algorithm>
#include <utility>

namespace ruffini::sim {
namespace {

constexpr uint64_t kLatencyUs = 300;
constexpr uint64_t kLateUs = 200'000;  // at most

}  // namespace

SimLine::SimLine(Dice dice, Swarm& swarm, EventLog& log, const uint64_t& now_us)
    : dice_(dice), swarm_(swarm), log_(log), now_us_(now_us) {}

int SimLine::device_read(std::span<uint8_t> out) {
  if (!is_open_) return -1;
  size_t n = 0;
  while (!down_.empty() && down_.front().at_us <= now_us_ && n < out.size()) {
    std::vector<uint8_t>& bytes = down_.front().bytes;
    const size_t n_taken = std::min(bytes.size(), out.size() - n);
    std::copy_n(bytes.begin(), n_taken, out.begin() + static_cast<ptrdiff_t>(n));
    n += n_taken;
    n_dropped_on_hang_up_ -= n_taken;
    if (n_taken == bytes.size()) {
      down_.pop_front();
    } else {
      bytes.erase(bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(n_taken));
    }
  }
  on_received(out.first(n));
  return static_cast<int>(n);
}

int SimLine::device_write(std::span<const uint8_t> bytes) {
  if (!is_open_) return -1;
  size_t n = std::min(bytes.size(), kRoomBytes - std::min(n_up_, kRoomBytes));
  if (n > 1 && swarm_.strikes(Fault::kShortWrite, 200'000)) n = dice_.between(1, n);
  on_sent(bytes.first(n));
  send(up_, bytes.first(n));
  return static_cast<int>(n);
}

bool SimLine::device_open() {
  is_open_ = is_connected_;
  return is_open_;
}

void SimLine::host_write(std::span<const uint8_t> bytes) {
  if (is_connected_ && n_dropped_on_hang_up_ + bytes.size() < kMaxDown) send(down_, bytes);
}

std::vector<uint8_t> SimLine::host_read(size_t at_most) {
  std::vector<uint8_t> out;
  while (!up_.empty() && up_.front().at_us <= now_us_ && out.size() < at_most) {
    Piece piece = std::move(up_.front());
    up_.pop_front();
    n_up_ -= piece.bytes.size();
    if (swarm_.strikes(Fault::kEcho, 20'000) && n_dropped_on_hang_up_ + piece.bytes.size() < kMaxDown)
      send(down_, piece.bytes);
    out.insert(out.end(), piece.bytes.begin(), piece.bytes.end());
  }
  return out;
}

void SimLine::hang_up() {
  log_.say(now_us_, "the line hangs up");
  is_connected_ = is_open_ = false;
  up_.clear();
  down_.clear();
  n_up_ = n_dropped_on_hang_up_ = 0;
}

void SimLine::send(std::deque<Piece>& queue, std::span<const uint8_t> bytes) {
  size_t& n_queued = &queue == &up_ ? n_up_ : n_dropped_on_hang_up_;
  while (!bytes.empty()) {
    const size_t n = std::min(bytes.size(), kPieceBytes);
    Piece piece{now_us_ + kLatencyUs, {bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(n)}};
    bytes = bytes.subspan(n);
    if (swarm_.strikes(Fault::kPieceLost, 10'000)) continue;
    if (swarm_.strikes(Fault::kPieceFlipped, 10'000)) {
      for (uint64_t i = dice_.between(1, 4); i > 0; --i) {
        piece.bytes[dice_.below(n)] ^= static_cast<uint8_t>(1 << dice_.below(8));
      }
    }
    if (swarm_.strikes(Fault::kPieceLate, 10'000)) piece.at_us += dice_.below(kLateUs);
    if (!queue.empty()) piece.at_us = std::max(piece.at_us, queue.back().at_us);  // bytes do not overtake
    const bool is_twice = swarm_.strikes(Fault::kPieceTwice, 5'000);
    n_queued += piece.bytes.size() * (is_twice ? 2 : 1);
    if (is_twice) queue.push_back(piece);
    queue.push_back(std::move(piece));
    if (queue.size() > 1 && swarm_.strikes(Fault::kPiecesSwapped, 5'000)) {
      std::swap(queue.back().bytes, queue[queue.size() - 2].bytes);
    }
  }
}

}  // namespace ruffini::sim
