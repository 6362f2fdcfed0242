#include "hw/notify_socket.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <charconv>
#include <cstddef>
#include <cstdlib>
#include <cstring>

namespace ruffini {
namespace {

uint64_t number_of(const char* text) {
  uint64_t value = 0;
  if (text != nullptr) std::from_chars(text, text + std::strlen(text), value);
  return value;
}

}  // namespace

NotifySocket NotifySocket::from_environment() {
  const char* address = std::getenv("NOTIFY_SOCKET");
  const char* pid = std::getenv("WATCHDOG_PID");
  const bool is_ours = pid == nullptr || number_of(pid) == static_cast<uint64_t>(::getpid());
  return {address == nullptr ? "" : address, is_ours ? number_of(std::getenv("WATCHDOG_USEC")) : 0};
}

NotifySocket::NotifySocket(const std::string& address, uint64_t watchdog_us) {
  sockaddr_un to{};
  to.sun_family = AF_UNIX;
  if (address.empty() || address.size() >= sizeof to.sun_path) return;
  std::memcpy(to.sun_path, address.data(), address.size());
  if (address[0] == '@') to.sun_path[0] = '\0';
  const auto n_bytes = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + address.size());
  UniqueFd socket(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket || ::connect(socket.get(), reinterpret_cast<const sockaddr*>(&to), n_bytes) != 0) return;
  socket_ = std::move(socket);
  watchdog_us_ = watchdog_us;
}

void NotifySocket::send(std::string_view what) const {
  if (socket_) (void)::send(socket_.get(), what.data(), what.size(), MSG_NOSIGNAL);
}

}  // namespace ruffini
