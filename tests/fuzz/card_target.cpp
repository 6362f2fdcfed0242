// libFuzzer: any bytes as a network's file. What is taken has outputs with names and ranges within the limits.
#include <sys/mman.h>
#include <unistd.h>

#include <string>

#include "device.h"
#include "infer/learned_result.h"
#include "infer/network.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const int kFile = ::memfd_create("network", 0);
  static const std::string kPath = "/proc/self/fd/" + std::to_string(kFile);
  static const ruffini::BoardSettings kBoard = ruffini::test::round_board();
  ruffini::fuzz::expect(::ftruncate(kFile, 0) == 0 && ::pwrite(kFile, data, size, 0) == static_cast<ssize_t>(size),
                        "a file in memory can be written");
  const auto card = ruffini::read_network_card(kPath, kBoard);
  if (!card) return 0;
  const size_t n = card.value().names.size();
  ruffini::fuzz::expect(n >= 1 && n <= ruffini::kMaxLearned && card.value().low.size() == n &&
                            card.value().high.size() == n && card.value().sha256.size() == 32,
                        "a card is whole");
  return 0;
}
