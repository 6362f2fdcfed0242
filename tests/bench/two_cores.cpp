// Frames a second of one frame thread and of two ([pipeline] cores) on the same pictures, in one run (two_cores.py).
//
//   ruffini_two_cores FOLDER     FOLDER as ruffini_bench reads it
//
// Blocks of frames alternate between the three ways, and the fastest of each counts, because others use the machine, too.
// Limit of the cut: a frame's time over that of the longer side. Limit of the machine: two units, each with a thread of its
// own, against one.
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <functional>
#include <iostream>
#include <thread>

#include "base/turnstile.h"
#include "link/messages.h"
#include "recorded_input.h"
#include "segment_cut.h"
#include "segment_turns.h"

namespace {

using namespace ruffini;
using namespace ruffini::bench;

constexpr int kRounds = 25;
constexpr uint32_t kBlock = 40;  // frames

uint64_t now_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
          .count());
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

using Types = std::vector<ruffini_MessageType>;

template <typename T>
using Times = std::array<T, kMaxRows + 2>;

// One sensor with its frames, processed by one thread or two as in daemon.cpp.
class Unit {
 public:
  Unit(const Input& input, int n_cores, Types types)
      : input_(input), types_(std::move(types)), path_(path_of(input, n_cores)), encoder_(*path_, 0) {
    for (int i = 0; i < input.board.n_rest_frames; ++i) path_->process(input.view(input.rest));
  }

  void run_block() {
    const uint32_t end = n_frames_ + kBlock;
    std::thread second;
    if (path_->n_segments() > 1) {
      second = std::thread([this, end] {
        for (uint32_t number = end - kBlock; number < end; ++number) {
          handed_.wait_for(number + 1);
          finish(number);
        }
      });
    }
    for (; n_frames_ < end; ++n_frames_) {
      start(n_frames_);
      if (second.joinable()) {
        turns_.run(*path_, flights_[n_frames_ % 2].frame, n_frames_, cut_.get());
        turns_.enter(*path_, flights_[n_frames_ % 2].frame, n_frames_);
        handed_.pass();
      } else {
        finish(n_frames_);
      }
    }
    if (second.joinable()) second.join();
  }

  // Medians in milliseconds: each row of the table, then the packets and the whole frame, waiting included.
  [[nodiscard]] Times<double> medians_ms() const {
    Times<double> out{};
    for (size_t row = 0; row < out.size(); ++row) {
      std::vector<double> values;
      for (const auto& frame : times_ns_) values.push_back(static_cast<double>(frame[row]));
      out[row] = median(std::move(values)) / 1e6;
    }
    return out;
  }

 private:
  static std::unique_ptr<FramePath> path_of(const Input& input, int n_cores) {
    BoardSettings board = input.board;
    board.n_cores = n_cores;
    return value_or_exit(FramePath::configure(board, input.calibration, now_ns));
  }

  struct Flight {
    Frame frame{};
    uint64_t begin_ns = 0;
  };

  void start(uint32_t number) {
    turns_.wait_to_begin(*path_, number);
    const std::vector<uint8_t>& pixels = number % 2 == 0 ? input_.pressed : input_.pressed_again;
    Flight& flight = flights_[number % 2];
    flight = {.begin_ns = now_ns()};
    flight.frame = path_->begin(input_.view(pixels), 16'667 * (number + uint64_t{1}));
    path_->enter(0, flight.frame);
  }

  void finish(uint32_t number) {
    const size_t n = path_->n_segments();
    Flight& flight = flights_[number % 2];
    turns_.run(*path_, flight.frame, number, n);
    const uint64_t start = now_ns();
    const FrameStamp stamp{.capture_us = flight.frame.capture_us, .frame = number};
    for (const ruffini_MessageType type : types_) encoder_.encode(type, *path_, flight.frame.view, stamp, sink_);
    auto& times = times_ns_.emplace_back();
    std::copy(path_->state().stage_ns.begin(), path_->state().stage_ns.end(), times.begin());
    times[kMaxRows] = now_ns() - start;
    times[kMaxRows + 1] = now_ns() - flight.begin_ns;
    flight.frame.segment_ns[n - 1] += times[kMaxRows];
    if (n > 1) cut_.record(flight.frame.segment_ns, n);
    turns_.end(*path_, flight.frame);
  }

  const Input& input_;
  Types types_;
  std::unique_ptr<FramePath> path_;
  MessageEncoder encoder_;
  MessageEncoder::Sink sink_ = [](ruffini_MessageType, std::span<const uint8_t>) {};
  std::array<Flight, 2> flights_{};
  SegmentTurns turns_;
  Turnstile handed_;
  SegmentCut cut_;
  uint32_t n_frames_ = 0;
  std::vector<Times<uint64_t>> times_ns_;
};

// Frames a second.
double rate_of(uint32_t n_frames, const std::function<void()>& work) {
  const uint64_t start = now_ns();
  work();
  return n_frames * 1e9 / static_cast<double>(now_ns() - start);
}

void measure(const Input& input, const char* label, const Types& types) {
  Unit one(input, 1, types);
  Unit two(input, 2, types);
  std::array<Unit, 2> apart{Unit(input, 1, types), Unit(input, 1, types)};
  double fastest_one = 0, fastest_two = 0, fastest_apart = 0;
  std::vector<double> ratios;
  for (int round = 0; round < kRounds; ++round) {
    const double with_one = rate_of(kBlock, [&] { one.run_block(); });
    const double with_two = rate_of(kBlock, [&] { two.run_block(); });
    const double with_apart = rate_of(2 * kBlock, [&] {
      std::thread other([&] { apart[1].run_block(); });
      apart[0].run_block();
      other.join();
    });
    ratios.push_back(with_two / with_one);
    fastest_one = std::max(fastest_one, with_one);
    fastest_two = std::max(fastest_two, with_two);
    fastest_apart = std::max(fastest_apart, with_apart);
  }
  const Times<double> ms = one.medians_ms();
  const std::vector<size_t> segment_of = segments_of(input.board.stages);
  std::vector<double> segments_ms(segment_of.back() + 1);
  for (const std::string& stage : input.board.stages) segments_ms[segment_of[stage_row(stage)]] += ms[stage_row(stage)];
  segments_ms.back() += ms[kMaxRows];
  double whole_ms = 0;
  std::string segments;
  for (const double each : segments_ms) {
    std::array<char, 32> text{};
    std::snprintf(text.data(), text.size(), "%s%.3f", segments.empty() ? "" : " + ", each);
    segments += text.data();
    whole_ms += each;
  }
  double longer_side_ms = whole_ms, before_cut_ms = 0;
  for (const double each : segments_ms) {
    before_cut_ms += each;
    longer_side_ms = std::min(longer_side_ms, std::max(before_cut_ms, whole_ms - before_cut_ms));
  }
  std::printf("%dx%d, %s: segments of %s ms\n", input.board.camera.width_px, input.board.camera.height_px, label,
              segments.c_str());
  std::printf("  frames a second   one core %8.1f   two cores %8.1f\n", fastest_one, fastest_two);
  std::printf("  ratio             of the fastest blocks %.2f, median of pairs %.2f   wanted: at least 1.7\n",
              fastest_two / fastest_one, median(ratios));
  std::printf("  a frame takes     %.3f ms and %.3f ms   wanted: at most twice the first\n", ms.back(),
              two.medians_ms().back());
  std::printf("  limits            of the best cut %.2f, of this machine (two units at once) %.2f\n",
              whole_ms / longer_side_ms, fastest_apart / fastest_one);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: ruffini_two_cores FOLDER\n";
    return 2;
  }
  const Input input(argv[1]);
  measure(input, "wrench and contacts sent",
          {ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_CONTACTS});
  measure(input, "field, depth and markers sent, too",
          {ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_FIELD,
           ruffini_MessageType_MESSAGE_TYPE_DEPTH, ruffini_MessageType_MESSAGE_TYPE_CONTACTS,
           ruffini_MessageType_MESSAGE_TYPE_MARKERS});
  return 0;
}
