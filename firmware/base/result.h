// Result<T>: a value or an Error. No exceptions in firmware.
#pragma once

#include <cassert>
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace ruffini {

// What kind of failure, hence who reacts and how.
enum class ErrorKind {
  kBadInput,     // bytes from outside do not make sense
  kUnavailable,  // hardware, file or line is missing or busy
  kRefused,      // understood, and not allowed: wrong board, wrong key
  kStorage,      // the medium failed
  kBusy,         // somebody else has it: later
};

// `message`: what happened, on what, and what to do, in one sentence.
struct Error {
  ErrorKind kind;
  std::string message;
};

template <typename T>
class [[nodiscard]] Result {
 public:
  // Implicit, so that `return value;` and `return Error{...};` both read as they are meant.
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

// Puts what was loaded where it belongs.
template <typename T>
Status keep(Result<T> loaded, std::optional<T>& part) {
  if (!loaded) return loaded.error();
  part.emplace(std::move(loaded).value());
  return Unit{};
}

}  // namespace ruffini
