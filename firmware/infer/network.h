// A learned network: an ONNX file that says of itself for which board it is (proto/NETWORK.md), and who runs it.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/image_view.h"
#include "base/result.h"
#include "board/settings.h"

namespace ruffini {

// The file's metadata. Names carry their units; low and high: what was taught of each output, in those units.
struct NetworkCard {
  std::vector<std::string> names;
  std::vector<int64_t> low;
  std::vector<int64_t> high;
  std::string sha256;  // of the whole file
};

// Reads all but the weights. Errors: kUnavailable, no file; kBadInput, no network of ours; kRefused, another board's.
[[nodiscard]] Result<NetworkCard> read_network_card(const std::string& path, const BoardSettings& board);

class Network {
 public:
  virtual ~Network() = default;
  // What it says of a frame into `out`; false where it cannot run or has another number of outputs.
  [[nodiscard]] virtual bool look(const FrameView& frame, std::span<float> out) = 0;
};

struct LoadedNetwork {
  NetworkCard card;
  std::unique_ptr<Network> network;
};
using NetworkLoader = std::function<Result<LoadedNetwork>()>;

// Card and network of a file; loads libruffini_infer.so, which alone needs OpenCV's dnn, when it is first called.
[[nodiscard]] Result<LoadedNetwork> load_network(const std::string& path, const BoardSettings& board);

}  // namespace ruffini
