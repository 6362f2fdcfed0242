// libFuzzer: any node values through the encoder and back through the specification's decoder, and any bytes
// through that decoder. (The host's own decoder is fuzzed by hypothesis in tests/py/wire.)
#include <cstdlib>
#include <cstring>

#include "link/dense_codec.h"
#include "support/dense_decoder.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size < 2) return 0;
  const size_t n_components = 1 + data[0] % 3;
  const size_t n_nodes = (size - 1) / (sizeof(int32_t) * n_components);
  if (n_nodes == 0) return 0;
  std::vector<int32_t> values(n_nodes * n_components);
  std::memcpy(values.data(), data + 1, values.size() * sizeof(int32_t));
  // Small, still and large values, so that every width and both codecs come up.
  for (size_t i = 0; i < values.size(); ++i) values[i] >>= (data[0] >> 2) % 32;

  std::vector<uint8_t> bytes(ruffini::dense_bound(values.size()));
  const ruffini::DenseBytes made = ruffini::encode_dense(values, n_components, bytes);
  if (made.n_bytes > bytes.size()) std::abort();
  const bool is_sparse = made.codec == ruffini::DenseCodec::kSparse;
  const auto back = ruffini::test::decode_dense(is_sparse, n_nodes, n_components, {bytes.data(), made.n_bytes});
  if (!back || *back != values) std::abort();

  (void)ruffini::test::decode_dense(data[0] % 2 == 0, n_nodes, n_components, {data + 1, size - 1});
  return 0;
}
