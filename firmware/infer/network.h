// A learned network: an ONNX file whose metadata names its board (proto/NETWORK.md), and its runtime.
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

// Metadata of the file. Names include units; low and high: training range of each output, in those units.
struct NetworkCard {
  std::vector<std::string> names;
  std::vector<int64_t> low;
  std::vector<int64_t> high;
  std::string sha256;  // of the whole file
};

// Reads everything but the weights. Errors: kUnavailable if there is no file; kBadInput if it is not a valid network;
// kRefused if it is for another board.
[[nodiscard]] Result<NetworkCard> read_network_card(const std::string& path, const BoardSettings& board);

class Network {
 public:
  virtual ~Network() = default;
  // Writes the outputs for a frame to `out`. Returns false if the network cannot run or has another number of outputs.
  [[nodiscard]] virtual bool infer(const FrameView& frame, std::span<float> out) = 0;
};

struct LoadedNetwork {
  NetworkCard card;
  std::unique_ptr<Network> network;
};
using NetworkLoader = std::function<Result<LoadedNetwork>()>;

// Loads card and network of a file. The first call loads libruffini_infer.so, the only library that needs OpenCV's dnn.
[[nodiscard]] Result<LoadedNetwork> load_network(const std::string& path, const BoardSettings& board);

}  // namespace ruffini
