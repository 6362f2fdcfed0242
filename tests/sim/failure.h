// A promise that was broken: ends the simulation.
#pragma once

#include <stdexcept>
#include <string>

namespace ruffini::sim {

struct Failure : std::runtime_error {
  using std::runtime_error::runtime_error;
};

inline void want(bool is_true, const std::string& promise) {
  if (!is_true) throw Failure(promise);
}

}  // namespace ruffini::sim
