// libFuzzer: a calibration store with anything in it, on a medium whose calls fail. The device must start or say why,
// start alike twice, use no file whose signature does not fit, and take a good file once the medium works.
#include <memory>
#include <utility>

#include "device.h"
#include "support/crash_medium.h"

namespace ruffini {
namespace {

using fuzz::Bytes;
using fuzz::expect;
using fuzz::Input;

const BoardSettings& board() {
  static const BoardSettings kBoard = fuzz::small_board();
  return kBoard;
}
const Bytes& table() {
  static const Bytes kTable = test::sign(test::diagonal_calibration(board()));
  return kTable;
}
uint64_t no_clock() { return 0; }

// The calls that still work; each one after that fails.
struct Luck {
  int n_calls = 1'000'000;
  bool fails() { return n_calls-- <= 0; }
};

// A medium shared by several starts of the device.
class SharedMedium : public Storage {
 public:
  SharedMedium(std::shared_ptr<test::CrashMedium> medium, std::shared_ptr<Luck> luck)
      : medium_(std::move(medium)), luck_(std::move(luck)) {}
  [[nodiscard]] Result<std::vector<std::string>> list() const override {
    if (luck_->fails()) return broken();
    return medium_->list();
  }
  [[nodiscard]] Result<Bytes> read(const std::string& name, ReadFrom from) const override {
    if (luck_->fails()) return broken();
    return medium_->read(name, from);
  }
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override {
    if (luck_->fails()) return broken();
    return medium_->create(name, n_bytes);
  }
  [[nodiscard]] Status rename(const std::string& from, const std::string& to) override {
    if (luck_->fails()) return broken();
    return medium_->rename(from, to);
  }
  [[nodiscard]] Status remove(const std::string& name) override {
    if (luck_->fails()) return broken();
    return medium_->remove(name);
  }
  [[nodiscard]] Status sync_folder() override {
    if (luck_->fails()) return broken();
    return medium_->sync_folder();
  }
  [[nodiscard]] Status can_write() const override {
    if (luck_->fails()) return broken();
    return Unit{};
  }
  [[nodiscard]] std::string path(const std::string& name) const override { return medium_->path(name); }

 private:
  static Error broken() { return {ErrorKind::kStorage, "medium: the call failed"}; }
  std::shared_ptr<test::CrashMedium> medium_;
  std::shared_ptr<Luck> luck_;
};

std::string name_of(Input& in) {
  switch (const uint8_t kind = in.u8(); kind % 7) {
    case 0:
      return "trial.safetensors";
    case 1:
      return "incoming.tmp";
    case 2: {
      const Bytes odd = in.bytes(kind / 6);
      return {odd.begin(), odd.end()};
    }
    case 3:
      return "calibration-" + std::to_string(UINT64_MAX - in.u8() % 3) + ".safetensors";
    case 4:
      return "calibration-" + std::to_string(in.u8()) + ".epoch-" + std::to_string(in.u8() << kind / 8) +
             ".safetensors";
    default:
      return "calibration-" + std::to_string(in.u8()) + ".safetensors";
  }
}

Bytes content_of(Input& in) {
  const uint8_t how = in.u8();
  if (how % 8 == 0) return in.bytes(in.u16());
  if (how % 8 < 3) return table();
  Bytes file = in.spoilt(table());
  file.resize(std::max<size_t>(file.size(), crypto_sign_BYTES));
  return how % 8 < 6 ? file : test::sign(std::move(file));
}

// The hash of what is in force after a start; empty: nothing. nullopt: it did not start.
std::optional<std::string> start(Exchange& exchange, std::unique_ptr<Storage> medium) {
  Calibrator calibrator(board(), "0000", SlotStore::open(std::move(medium)), exchange);
  std::string problem;
  if (!calibrator.start(no_clock, problem)) return std::nullopt;
  return calibrator.active().is_present ? calibrator.active().sha256 : std::string();
}

void check(Exchange& exchange, Input& in) {
  test::Names names;
  std::vector<std::string> sound;  // hashes of the files whose signature fits
  const uint8_t n_failing = in.u8();
  for (int n = in.u8() % 5; n > 0; --n) {
    const std::string name = name_of(in);
    const Bytes content = content_of(in);
    names[name] = std::make_shared<test::Inode>(test::Inode{content, 0, true});
    if (fuzz::is_signed(content)) sound.push_back(sha256(content));
  }
  const auto medium = std::make_shared<test::CrashMedium>(names);
  const auto luck = std::make_shared<Luck>();
  const auto shared = [&] { return std::make_unique<SharedMedium>(medium, luck); };
  const auto is_sound = [&](const std::string& hash) {
    return hash.empty() || std::find(sound.begin(), sound.end(), hash) != sound.end();
  };

  luck->n_calls = n_failing % 16;  // few calls work: it says so, or does with less
  const auto unlucky = start(exchange, shared());
  expect(!unlucky || is_sound(*unlucky), "in force is a file whose signature fits");

  luck->n_calls = 1'000'000;
  const auto first = start(exchange, shared());
  expect(first && is_sound(*first), "it starts with a sound file or without");
  expect(medium->names().count("trial.safetensors") + medium->names().count("incoming.tmp") == 0,
         "nothing half done is left after a start");
  expect(start(exchange, shared()) == first, "a second start is like the first");

  Calibrator calibrator(board(), "0000", SlotStore::open(shared()), exchange);
  std::string problem;
  expect(calibrator.start(no_clock, problem).has_value(), "it starts");
  const std::string wanted = sha256(table());
  expect(calibrator.begin(table().size(), wanted) && calibrator.chunk(0, table()), "an upload is taken");
  luck->n_calls = n_failing < 128 ? n_failing / 16 : 1'000'000;
  // A stranger's names may leave no number, or an epoch that forbids the good file.
  const bool is_plain = std::none_of(names.begin(), names.end(), [](const auto& file) {
    return file.first.find("1844") != std::string::npos || file.first.find("epoch") != std::string::npos;
  });
  const Status done = calibrator.commit();
  expect(n_failing < 128 || !is_plain || done.has_value(), "a good file is taken");
  if (done) {
    exchange.tally = {static_cast<FramePath*>(exchange.next_path)->calibration_id(), 256, 256};
    const auto end = calibrator.poll();
    expect(end.has_value(), "the trial ends");
    luck->n_calls = 1'000'000;
    if (end->is_confirmed) expect(start(exchange, shared()) == wanted, "what was confirmed is in force from then on");
  } else {
    luck->n_calls = 1'000'000;
    expect(start(exchange, shared()) == first, "what was not taken changes nothing");
  }
  delete exchange.next_path.exchange(nullptr);
}

}  // namespace
}  // namespace ruffini

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static ruffini::Exchange exchange;  // its ring of 4 MiB is made once
  ruffini::fuzz::Input in(data, size);
  ruffini::check(exchange, in);
  return 0;
}
