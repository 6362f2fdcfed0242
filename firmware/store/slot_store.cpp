#include "store/slot_store.h"

#include <algorithm>
#include <charconv>
#include <functional>
#include <string_view>
#include <utility>

#include "store/folder_storage.h"

namespace ruffini {
namespace {

constexpr std::string_view kPrefix = "calibration-";
constexpr std::string_view kEpoch = ".epoch-";
constexpr std::string_view kSuffix = ".safetensors";
constexpr char kIncoming[] = "incoming.tmp";
constexpr char kTrial[] = "trial.safetensors";
constexpr uint64_t kLast = UINT64_MAX - 1;  // so that one more can be counted

using Slot = SlotStore::Slot;

std::string name_of(const Slot& slot) {
  const std::string epoch = slot.epoch == 0 ? "" : std::string(kEpoch) + std::to_string(slot.epoch);
  return std::string(kPrefix) + std::to_string(slot.generation) + epoch + std::string(kSuffix);
}

// The numbers in a name that name_of() would write; nothing else is a calibration.
std::optional<Slot> slot_of(const std::string& name) {
  if (name.size() <= kPrefix.size() + kSuffix.size() || name.compare(0, kPrefix.size(), kPrefix) != 0) return {};
  Slot slot;
  const char* end = name.data() + name.size();
  const char* at = std::from_chars(name.data() + kPrefix.size(), end, slot.generation).ptr;
  const std::string_view rest(at, static_cast<size_t>(end - at));
  if (rest.substr(0, kEpoch.size()) == kEpoch) std::from_chars(at + kEpoch.size(), end, slot.epoch);
  return name_of(slot) == name && slot.generation <= kLast ? std::optional(slot) : std::nullopt;
}

// The highest that any of them carries, so that a file that follows cannot lower it.
uint32_t reached(const std::vector<Slot>& slots) {
  uint32_t epoch = 0;
  for (const Slot& slot : slots) epoch = std::max(epoch, slot.epoch);
  return epoch;
}

}  // namespace

// A medium that cannot be written to, or not be read, is no reason not to start: what is in force there, if anything, is
// in use, and what is to be said of it is said.
SlotStore SlotStore::open(std::unique_ptr<Storage> medium) {
  SlotStore store(std::move(medium));
  const Result<bool> cleared = store.remove_if_there(kIncoming);
  const auto names = store.medium_->list();
  store.has_lost_trial_ = names && std::find(names.value().begin(), names.value().end(), kTrial) != names.value().end();
  const Result<bool> on_trial = store.remove_if_there(kTrial);
  const Status writable = store.can_write();
  // A rename whose sync failed before this start is seen, and a power cut would still take it back.
  const Status durable = store.medium_->sync_folder();
  if (!writable) {
    store.problem_ = writable.error().message;
  } else if (!cleared || !on_trial) {
    store.problem_ = (cleared ? on_trial : cleared).error().message;
  } else if (!durable) {
    store.problem_ = durable.error().message;
  }
  return store;
}

Result<SlotStore> SlotStore::open(const std::string& folder) {
  auto medium = FolderStorage::open(folder);
  if (!medium) return medium.error();
  return open(std::move(medium).value());
}

Status SlotStore::can_write() const {
  const Status can = medium_->can_write();
  if (can) return can;
  return Error{ErrorKind::kStorage, can.error().message + "; what is in force goes on, nothing can be flashed"};
}

Result<uint32_t> SlotStore::epoch() const {
  const auto found = slots();
  if (!found) return found.error();
  return reached(found.value());
}

// The newest first.
Result<std::vector<Slot>> SlotStore::slots() const {
  const auto names = medium_->list();
  if (!names) return names.error();
  std::vector<Slot> found;
  for (const std::string& name : names.value()) {
    if (const std::optional<Slot> slot = slot_of(name)) found.push_back(*slot);
  }
  std::sort(found.begin(), found.end(), std::greater<>());
  return found;
}

Result<std::vector<uint8_t>> SlotStore::load(size_t n) const {
  const auto found = slots();
  if (!found) return found.error();
  if (found.value().size() <= n) return std::vector<uint8_t>{};
  const std::string name = name_of(found.value()[n]);
  auto bytes = medium_->read(name, ReadFrom::kAnywhere);
  if (!bytes || !bytes.value().empty()) return bytes;
  return Error{ErrorKind::kStorage, medium_->path(name) + ": is empty: the medium has lost what was written to it"};
}

// What comes into force next, after those that there are.
Result<Slot> SlotStore::next_slot(const std::vector<Slot>& found, uint32_t epoch) const {
  const Slot next{found.empty() ? 1 : found.front().generation + 1, std::max(epoch, reached(found))};
  if (next.generation <= kLast) return next;
  return Error{ErrorKind::kStorage,
               medium_->path(name_of(found.front())) +
                   ": no number is left above this one, and no device counts so far: remove the file"};
}

Status SlotStore::stage(std::span<const uint8_t> bytes) {
  const auto found = slots();
  if (!found) return found.error();
  if (const auto next = next_slot(found.value(), 0); !next) return next.error();
  Status done = write_checked(bytes);
  if (done) done = medium_->rename(kIncoming, kTrial);
  if (done) done = medium_->sync_folder();
  if (!done) {  // the first error is the one to tell
    (void)remove_if_there(kIncoming);
    (void)remove_if_there(kTrial);
  }
  return done;
}

Status SlotStore::confirm(uint32_t epoch, size_t before) {
  const auto found = slots();
  if (!found) return found.error();
  const auto next = next_slot(found.value(), epoch);
  if (!next) return next.error();
  Status done = medium_->rename(kTrial, name_of(next.value()));
  if (done) done = medium_->sync_folder();
  // Only now: until then a power cut may leave the file before this one in force.
  for (size_t i = 0; done && i < found.value().size(); ++i) {
    if (i != before) (void)medium_->remove(name_of(found.value()[i]));  // what stays takes room, and goes the next time
  }
  return done;
}

// Not synced: a trial that comes back after a power cut is removed at start.
Status SlotStore::reject() { return medium_->remove(kTrial); }

Status SlotStore::undo(size_t n) {
  const auto found = slots();
  if (!found) return found.error();
  const auto next = next_slot(found.value(), 0);
  if (!next) return next.error();
  const std::string before = name_of(found.value()[n]);
  const std::string undone = name_of(next.value());
  Status done = medium_->rename(before, undone);
  if (!done) return done;
  done = medium_->sync_folder();
  // Not said to be done: the next undo must find it to do. What a power cut leaves, the next start says.
  if (!done) (void)medium_->rename(undone, before);
  return done;
}

// Writes the temporary file, and reads back from the medium what that kept.
Status SlotStore::write_checked(std::span<const uint8_t> bytes) {
  const Result<bool> cleared = remove_if_there(kIncoming);
  if (!cleared) return cleared.error();
  {
    auto file = medium_->create(kIncoming, bytes.size());
    if (!file) return file.error();
    Status done = file.value()->write(bytes);
    if (done) done = file.value()->sync();
    if (!done) return done;
  }
  const auto back = medium_->read(kIncoming, ReadFrom::kMedium);
  if (!back) return back.error();
  if (!std::equal(bytes.begin(), bytes.end(), back.value().begin(), back.value().end())) {
    return Error{ErrorKind::kStorage, medium_->path(kIncoming) +
                                          ": the medium keeps other bytes than were written to "
                                          "it: check it, and replace it"};
  }
  return Unit{};
}

Result<bool> SlotStore::remove_if_there(const std::string& name) {
  const auto names = medium_->list();
  if (!names) return names.error();
  if (std::find(names.value().begin(), names.value().end(), name) == names.value().end()) return false;
  const Status removed = medium_->remove(name);
  if (!removed) return removed.error();
  return true;
}

}  // namespace ruffini
