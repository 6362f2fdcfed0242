#include "hw/i2c.h"

#include <fcntl.h>
#include <linux/i2c-dev.h>
#include <linux/i2c.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "base/unique_fd.h"

namespace ruffini {
namespace {

constexpr int kTries = 3;
constexpr unsigned long kTimeout10Ms = 2;
constexpr size_t kChunkBytes = 32;  // maximum message length: some adapters accept no more

class KernelBus final : public I2cBus {
 public:
  KernelBus(UniqueFd fd, std::string path) : fd_(std::move(fd)), path_(std::move(path)) {}

  int transfer(uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in) override {
    std::array<i2c_msg, 2> messages{};
    uint32_t n = 0;
    // The kernel does not modify the buffer of a write.
    if (!out.empty()) messages[n++] = message(address, 0, const_cast<uint8_t*>(out.data()), out.size());
    if (!in.empty()) messages[n++] = message(address, I2C_M_RD, in.data(), in.size());
    i2c_rdwr_ioctl_data both{messages.data(), n};
    return ::ioctl(fd_.get(), I2C_RDWR, &both) < 0 ? errno : 0;
  }
  [[nodiscard]] std::string name() const override { return path_; }

 private:
  static i2c_msg message(uint8_t address, int flags, uint8_t* bytes, size_t n) {
    i2c_msg one{};
    one.addr = address;
    one.flags = static_cast<uint16_t>(flags);
    one.len = static_cast<uint16_t>(n);
    one.buf = bytes;
    return one;
  }

  UniqueFd fd_;
  std::string path_;
};

std::string at(const I2cBus& bus, uint8_t address) {
  std::array<char, 8> text{};
  std::snprintf(text.data(), text.size(), "0x%02x", unsigned{address});
  return bus.name() + ", address " + text.data();
}

}  // namespace

Result<std::unique_ptr<I2cBus>> open_i2c(const std::string& path) {
  UniqueFd fd(::open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!fd) {
    return Error{ErrorKind::kUnavailable, path + ": cannot be opened: " + std::strerror(errno) +
                                              ": is I2C switched on (dtparam=i2c_arm=on, modprobe i2c-dev), and are "
                                              "you in the group i2c?"};
  }
  unsigned long functions = 0;
  if (::ioctl(fd.get(), I2C_FUNCS, &functions) != 0 || (functions & I2C_FUNC_I2C) == 0) {
    return Error{ErrorKind::kUnavailable, path + ": is no I2C bus with plain transfers: see i2cdetect -l"};
  }
  ::ioctl(fd.get(), I2C_TIMEOUT, kTimeout10Ms);
  ::ioctl(fd.get(), I2C_RETRIES, 0UL);
  return std::unique_ptr<I2cBus>(std::make_unique<KernelBus>(std::move(fd), path));
}

Status exchange(I2cBus& bus, uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in) {
  int problem = 0;
  for (int i = 0; i < kTries; ++i) {
    problem = bus.transfer(address, out, in);
    if (problem == 0) return Unit{};
  }
  const bool is_absent = problem == ENXIO || problem == EREMOTEIO;
  return Error{ErrorKind::kUnavailable, at(bus, address) + ": " +
                                            (is_absent ? "nobody answers: is it plugged in, and is this its address "
                                                         "(i2cdetect -y)?"
                                                       : std::string(std::strerror(problem)) +
                                                             ": look at the wires, and that nothing holds SDA down")};
}

Result<std::vector<uint8_t>> read_eeprom(I2cBus& bus, uint8_t address, int address_bytes, size_t n_bytes) {
  std::vector<uint8_t> bytes(n_bytes);
  for (size_t done = 0; done < n_bytes; done += kChunkBytes) {
    const std::array<uint8_t, 2> place = {static_cast<uint8_t>(done >> 8), static_cast<uint8_t>(done)};
    const auto from = std::span(place).last(static_cast<size_t>(address_bytes));
    const auto to = std::span(bytes).subspan(done, std::min(kChunkBytes, n_bytes - done));
    if (Status read = exchange(bus, address, from, to); !read) return read.error();
  }
  return bytes;
}

}  // namespace ruffini
