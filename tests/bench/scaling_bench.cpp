// One program of a calibration file against Eigen's float32 matrix times vector of the same size, cache-cold.
//
//   ruffini_scaling_bench FILE N_IN N_OUT ROUNDS HAS_EIGEN
//
// FILE holds the program `operator`; tests/bench/scaling.py makes it and reads the JSON that this prints. Peers
// take turns in every round, and before each turn a buffer larger than the caches is written, so that tables
// come from memory. Memory's own speed is the time of reading 64 MiB.
#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <iterator>
#include <random>
#include <vector>

#include "solve/block_program.h"

namespace {

constexpr size_t kFlushBytes = size_t{96} << 20;
constexpr size_t kReadBytes = size_t{64} << 20;

double now_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

class Timer {
 public:
  template <typename Work>
  void time(Work work) {
    for (size_t i = 0; i < flush_.size(); i += 8) flush_[i] += 1;  // one word of each cache line
    const double start = now_s();
    work();
    times_.push_back(now_s() - start);
  }
  // Milliseconds.
  [[nodiscard]] double median() const {
    std::vector<double> sorted = times_;
    std::sort(sorted.begin(), sorted.end());
    return sorted.empty() ? 0 : 1e3 * sorted[sorted.size() / 2];
  }

 private:
  std::vector<double> times_;
  static inline std::vector<uint64_t> flush_ = std::vector<uint64_t>(kFlushBytes / 8);
};

[[noreturn]] void fail(const std::string& what) {
  std::cerr << what << "\n";
  std::exit(2);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 6) fail("usage: ruffini_scaling_bench FILE N_IN N_OUT ROUNDS HAS_EIGEN");
  std::ifstream in(argv[1], std::ios::binary);
  const std::vector<char> bytes{std::istreambuf_iterator<char>(in), {}};
  std::vector<uint64_t> aligned((bytes.size() + 7) / 8);
  std::memcpy(aligned.data(), bytes.data(), bytes.size());
  auto file = ruffini::Calibration::parse({reinterpret_cast<const uint8_t*>(aligned.data()), bytes.size()});
  if (!file) fail(file.error().message);
  const int n_in = std::atoi(argv[2]);
  const int n_out = std::atoi(argv[3]);
  auto program = ruffini::BlockProgram::load(file.value(), "operator", n_in, n_out);
  if (!program) fail(program.error().message);

  std::mt19937 random(1);  // NOLINT: the same numbers on every run
  std::vector<int16_t> u(static_cast<size_t>(n_in));
  for (int16_t& v : u) v = static_cast<int16_t>(static_cast<int>(random() % 16'001) - 8'000);
  std::vector<int64_t> out(static_cast<size_t>(n_out));
  const bool has_eigen = std::atoi(argv[5]) != 0;
  using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Matrix matrix = has_eigen ? Matrix(Matrix::Random(n_out, n_in)) : Matrix();
  const Eigen::VectorXf x = Eigen::VectorXf::Random(n_in);
  Eigen::VectorXf y(n_out);
  const std::vector<uint64_t> memory(kReadBytes / 8, 1);
  volatile uint64_t sink = 0;
  Timer ours;
  Timer eigen;
  Timer read;
  for (int i = 0; i < std::atoi(argv[4]); ++i) {
    ours.time([&] { program.value().run(u, out); });
    if (has_eigen) eigen.time([&] { y.noalias() = matrix * x; });
    read.time([&] {
      uint64_t sum = 0;
      for (const uint64_t v : memory) sum ^= v;
      sink = sum;
    });
  }
  std::cout << "{\"program_ms\": " << ours.median() << ", \"eigen_ms\": " << eigen.median()
            << ", \"read_gb_s\": " << static_cast<double>(kReadBytes) / read.median() / 1e6 << ", \"check\": "
            << (has_eigen ? static_cast<double>(y.sum()) : 0) + static_cast<double>(out[0]) + double(sink) << "}\n";
  return 0;
}
