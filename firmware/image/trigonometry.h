// Integer cosines for tables computed at configure time.
#pragma once

#include <cstdint>

namespace ruffini {

// Returns cos(pi numerator / denominator) in Q30, correctly rounded (computed to 2^-55). Precondition: denominator > 0,
// both < 2^31.
[[nodiscard]] int32_t cos_pi_q30(int64_t numerator, int64_t denominator);

}  // namespace ruffini
