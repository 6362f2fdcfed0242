// Result<T>: a value or an Error. No exceptions in firmware.
#pragma once

#include <cassert>
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace ruffini {

// Kind of failure. It decides who reacts, and how.
enum class ErrorKind {
  kBadInput,     // bytes from outside are malformed
  kUnavailable,  // hardware, a file or a line is missing or busy
  kRefused,      // well-formed, but not allowed: wrong board, wrong key
  kStorage,      // the medium failed
  kBusy,         // in use by another client: try again later
};

// `message`: one sentence that states what happened, to what, and what to do.
struct Error {
  ErrorKind kind;
  std::string message;
};

template <typename T>
class [[nodiscard]] Result {
 public:
  // Implicit, so that both `return value;` and `return Error{...};` compile.
  // NOLINTBEGIN(google-explicit-constructor)
  Result(T value) : state_(std::move(value)) {}
  Result(Error error) : state_(std::move(error)) {}
  // NOLINTEND(google-explicit-constructor)

  [[nodiscard]] bool has_value() const { return std::holds_alternative<T>(state_); }
  explicit operator bool() const { return has_value(); }

  // Precondition: has_value().
  [[nodiscard]] T& value() & {
    assert(has_value());
    return *std::get_if<T>(&state_);
  }
  [[nodiscard]] const T& value() const& {
    assert(has_value());
    return *std::get_if<T>(&state_);
  }
  [[nodiscard]] T&& value() && {
    assert(has_value());
    return std::move(*std::get_if<T>(&state_));
  }

  // Precondition: !has_value().
  [[nodiscard]] const Error& error() const {
    assert(!has_value());
    return *std::get_if<Error>(&state_);
  }

 private:
  std::variant<T, Error> state_;
};

struct Unit {};
using Status = Result<Unit>;

// Moves a loaded value into `part`, or returns the error.
template <typename T>
Status keep(Result<T> loaded, std::optional<T>& part) {
  if (!loaded) return loaded.error();
  part.emplace(std::move(loaded).value());
  return Unit{};
}

}  // namespace ruffini
