// What a frame costs on one core: every stage inside the real frame path, and peers on the same input.
//
//   ruffini_bench --data=FOLDER [google-benchmark options]
//
// FOLDER is made by tests/bench/benchmarks.py (recorded_input.h).
#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cstring>
#include <iostream>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "link/messages.h"
#include "recorded_input.h"

namespace {

using namespace ruffini;
using namespace ruffini::bench;

constexpr int kResiduals = 101;  // frames that are measured with one

uint64_t now_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
          .count());
}

cv::Mat grey_of(const Input& input, std::vector<uint8_t> pixels) {
  const cv::Mat bgr(input.board.camera.height_px, input.board.camera.width_px, CV_8UC3, pixels.data());
  cv::Mat out;
  cv::cvtColor(bgr, out, cv::COLOR_BGR2GRAY);
  return out;
}

double median(std::vector<uint64_t>& values) {
  const auto middle = values.begin() + static_cast<ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return static_cast<double>(*middle);
}

// What who subscribes to RESIDUAL costs besides the frame, its packet included; nanoseconds.
std::vector<uint64_t> residual(FramePath& path, MessageEncoder& encoder, const Input& input) {
  std::vector<uint64_t> ns;
  for (int i = 0; i < kResiduals; ++i) {
    path.process(input.view(input.pressed));
    const uint64_t start = now_ns();
    path.compute_residual();
    encoder.encode(ruffini_MessageType_MESSAGE_TYPE_RESIDUAL, path, input.view(input.pressed), {},
                   [](ruffini_MessageType, std::span<const uint8_t>) {});
    ns.push_back(now_ns() - start);
  }
  return ns;
}

// The whole frame, from pixels to encoded packets; medians in nanoseconds as counters: each stage's by its name.
void frame(benchmark::State& state, const Input& input) {
  const auto path = value_or_exit(FramePath::configure(input.board, input.calibration, now_ns));
  for (int i = 0; i < input.board.n_rest_frames; ++i) path->process(input.view(input.rest));
  MessageEncoder encoder(*path, 0);
  size_t n_bytes = 0;
  const auto count = [&](ruffini_MessageType, std::span<const uint8_t> bytes) { n_bytes += bytes.size(); };
  std::vector<std::vector<uint64_t>> stage_ns(kMaxRows);
  std::vector<uint64_t> encode_ns;
  std::vector<uint64_t> frame_ns;
  FrameStamp stamp;
  for (auto _ : state) {
    stamp.frame += 1;
    stamp.capture_us = 16'667 * stamp.frame;
    n_bytes = 0;
    const uint64_t start = now_ns();
    const FrameState& s = path->process(input.view(input.pressed), stamp.capture_us);
    const uint64_t processed = now_ns();
    for (const ruffini_MessageType type :
         {ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_FIELD,
          ruffini_MessageType_MESSAGE_TYPE_DEPTH, ruffini_MessageType_MESSAGE_TYPE_CONTACTS,
          ruffini_MessageType_MESSAGE_TYPE_MARKERS}) {
      encoder.encode(type, *path, input.view(input.pressed), stamp, count);
    }
    const uint64_t end = now_ns();
    encode_ns.push_back(end - processed);
    frame_ns.push_back(end - start);
    for (size_t i = 0; i < kMaxRows; ++i) stage_ns[i].push_back(s.stage_ns[i]);
  }
  for (const std::string& name : stage_names()) state.counters[name] = median(stage_ns[stage_row(name)]);
  state.counters["packets"] = median(encode_ns);
  state.counters["whole_frame"] = median(frame_ns);
  state.counters["packet_bytes"] = static_cast<double>(n_bytes);
  const auto& mask = path->state().solve.mask;
  state.counters["touched_nodes"] =
      static_cast<double>(std::ssize(mask) - std::count(mask.begin(), mask.end(), uint8_t{0}));
  state.counters["flags"] = path->state().flags;
  std::vector<uint64_t> residual_ns = residual(*path, encoder, input);
  state.counters["residual"] = median(residual_ns);
}

// OpenCV's pyramidal Lucas-Kanade on the board's own markers (at most n_points of them).
void lucas_kanade(benchmark::State& state, const Input& input, int n_points) {
  const auto path = value_or_exit(FramePath::configure(input.board, nullptr, now_ns));
  for (int i = 0; i < input.board.n_rest_frames; ++i) path->process(input.view(input.rest));
  std::vector<cv::Point2f> points;
  for (const Marker& m : path->markers()) {
    if (static_cast<int>(points.size()) == n_points) break;
    points.emplace_back(static_cast<float>(m.rest_x.raw()) / 65536.0F, static_cast<float>(m.rest_y.raw()) / 65536.0F);
  }
  const cv::Mat rest = grey_of(input, input.rest);
  const cv::Mat pressed = grey_of(input, input.pressed);
  std::vector<cv::Point2f> moved;
  std::vector<uint8_t> found;
  std::vector<float> error;
  for (auto _ : state) {
    cv::calcOpticalFlowPyrLK(rest, pressed, points, moved, found, error, cv::Size(15, 15), 3);
    benchmark::DoNotOptimize(moved.data());
  }
  state.counters["points"] = static_cast<double>(points.size());
}

// float32 matrix times vector, as large as the board's operator.
void eigen_gemv(benchmark::State& state, const Input& input) {
  const Eigen::Index n = Eigen::Index{3} * NodeGrid(input.board).size().count();
  const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> matrix = Eigen::MatrixXf::Random(n, n);
  const Eigen::VectorXf u = Eigen::VectorXf::Random(n);
  Eigen::VectorXf force(n);
  for (auto _ : state) {
    force.noalias() = matrix * u;
    benchmark::DoNotOptimize(force.data());
  }
  state.counters["n"] = static_cast<double>(n);
}

// What this machine's memory allows: copies of 64 MiB.
void memory_copy(benchmark::State& state) {
  constexpr size_t kBytes = size_t{64} << 20;
  std::vector<uint8_t> from(kBytes, 1);
  std::vector<uint8_t> to(kBytes);
  for (auto _ : state) {
    std::memcpy(to.data(), from.data(), kBytes);
    benchmark::DoNotOptimize(to.data());
    benchmark::ClobberMemory();
  }
  state.SetBytesProcessed(state.iterations() * static_cast<int64_t>(kBytes));
}

}  // namespace

int main(int argc, char** argv) {
  std::string folder;
  int kept = 1;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument.starts_with("--data="))
      folder = argument.substr(7);
    else
      argv[kept++] = argv[i];
  }
  argc = kept;
  benchmark::Initialize(&argc, argv);
  if (folder.empty() || benchmark::ReportUnrecognizedArguments(argc, argv)) {
    std::cerr << "usage: ruffini_bench --data=FOLDER [--benchmark_...]\n";
    return 2;
  }
  cv::setNumThreads(1);
  const Input input(folder);
  benchmark::RegisterBenchmark("frame", [&](benchmark::State& s) { frame(s, input); });
  benchmark::RegisterBenchmark("lucas_kanade/70", [&](benchmark::State& s) { lucas_kanade(s, input, 70); });
  benchmark::RegisterBenchmark("lucas_kanade/all", [&](benchmark::State& s) { lucas_kanade(s, input, 1 << 30); });
  benchmark::RegisterBenchmark("eigen_gemv", [&](benchmark::State& s) { eigen_gemv(s, input); });
  benchmark::RegisterBenchmark("memory_copy", memory_copy);
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  return 0;
}
