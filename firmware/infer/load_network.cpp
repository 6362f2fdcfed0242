#include <dlfcn.h>

#include "infer/network.h"
#include "infer/network_library.h"

namespace ruffini {

Result<LoadedNetwork> load_network(const std::string& path, const BoardSettings& board) {
  Result<NetworkCard> card = read_network_card(path, board);
  if (!card) return card.error();
  void* library = ::dlopen(kNetworkLibrary, RTLD_NOW | RTLD_LOCAL);  // stays to the end of the process
  void* opener = library == nullptr ? nullptr : ::dlsym(library, kNetworkOpener);
  if (opener == nullptr) {
    return Error{ErrorKind::kUnavailable, std::string(kNetworkLibrary) + ": cannot be loaded: install it beside " +
                                              "ruffinid, with OpenCV's dnn: it runs [learned] network"};
  }
  std::unique_ptr<Network> network(reinterpret_cast<NetworkOpener*>(opener)(path.c_str()));
  if (network == nullptr) {
    return Error{ErrorKind::kBadInput, path + ": no ONNX network that OpenCV can run: export it again"};
  }
  return LoadedNetwork{std::move(card).value(), std::move(network)};
}

}  // namespace ruffini
