// Time of the C++ consumer on one message: ruffini_client_decode FILE N, prints the median of N in nanoseconds.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <variant>
#include <vector>

#include "ruffini/client.h"

namespace client = ruffini::client;

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  std::ifstream in(argv[1], std::ios::binary);
  const std::vector<char> text{std::istreambuf_iterator<char>(in), {}};
  const std::vector<uint8_t> bytes(text.begin(), text.end());
  const long n_runs = std::strtol(argv[2], nullptr, 10);
  std::vector<double> ns;
  for (long i = 0; i < n_runs; ++i) {
    client::Decoder decoder;
    const auto begin = std::chrono::steady_clock::now();
    const auto packets = decoder.feed(bytes.data(), bytes.size());
    const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - begin;
    if (packets.size() != 1 || std::holds_alternative<std::monostate>(packets[0].message)) return 1;
    ns.push_back(took.count());
  }
  std::sort(ns.begin(), ns.end());
  std::printf("%.1f\n", ns[ns.size() / 2]);
  return 0;
}
