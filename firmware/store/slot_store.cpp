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
constexpr uint64_t kLast = UINT64_MAX - 1;  // leaves room for one more

using Slot = SlotStore::Slot;

std::string name_of(const Slot& slot) {
  const std::string epoch = slot.epoch == 0 ? "" : std::string(kEpoch) + std::to_string(slot.epoch);
  return std::string(kPrefix) + std::to_string(slot.generation) + epoch + std::string(kSuffix);
}

// Parses the numbers of a name that name_of() would write; other files are not calibrations.
std::optional<Slot> slot_of(const std::string& name) {
  if (name.size() <= kPrefix.size() + kSuffix.size() || name.compare(0, kPrefix.size(), kPrefix) != 0) return {};
  Slot slot;
  const char* end = name.data() + name.size();
  const char* at = std::from_chars(name.data() + kPrefix.size(), end, slot.generation).ptr;
  const std::string_view rest(at, static_cast<size_t>(end - at));
  if (rest.substr(0, kEpoch.size()) == kEpoch) std::from_chars(at + kEpoch.size(), end, slot.epoch);
  return name_of(slot) == name && slot.generation <= kLast ? std::optional(slot) : std::nullopt;
}

// Highest epoch of all files, so that a later file cannot lower it.
uint32_t reached(const std::vector<Slot>& slots) {
  uint32_t epoch = 0;
  for (const Slot& slot : slots) epoch = std::max(epoch, slot.epoch);
  return epoch;
}

}  // namespace

// A medium that cannot be written or read does not prevent the start: the file in force, if any, is used, and the
// problem is reported.
SlotStore SlotStore::open(std::unique_ptr<Storage> medium) {
  SlotStore store(std::move(medium));
  const Result<bool> cleared = store.remove_if_present(kIncoming);
  const auto names = store.medium_->list();
  store.has_discarded_trial_ =
      names && std::find(names.value().begin(), names.value().end(), kTrial) != names.value().end();
  const Result<bool> on_trial = store.remove_if_present(kTrial);
  const Status writable = store.can_write();
  // A rename whose sync failed before this start is visible, but a power cut could still revert it.
  (void)store.sync();
  if (!writable) {
    store.problem_ = writable.error().message;
  } else if (!cleared || !on_trial) {
    store.problem_ = (cleared ? on_trial : cleared).error().message;
  }
  return store;
}

Status SlotStore::sync() {
  Status done = medium_->sync_folder();
  is_durable_ = is_durable_ || done;
  if (!done) sync_problem_ = done.error().message;
  return done;
}

std::string SlotStore::unsynced() const {
  return is_durable_ ? "" : sync_problem_ + ": what is in force may not be so after a power cut";
}

Status SlotStore::rename(const std::string& from, const std::string& to) {
  Status done = medium_->rename(from, to);
  if (done) is_durable_ = false;
  return done;
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

// Sorted, newest first.
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

// Returns the slot that follows the existing ones.
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
  if (done) done = sync();
  if (!done) {  // report the first error
    (void)remove_if_present(kIncoming);
    (void)remove_if_present(kTrial);
  }
  return done;
}

Status SlotStore::confirm(uint32_t epoch, size_t before) {
  const auto found = slots();
  if (!found) return found.error();
  const auto next = next_slot(found.value(), epoch);
  if (!next) return next.error();
  Status done = rename(kTrial, name_of(next.value()));
  if (done) done = sync();
  // Only now: before this sync a power cut may leave the previous file in force.
  for (size_t i = 0; done && i < found.value().size(); ++i) {
    // A file that remains only takes space, and is removed the next time
    if (i != before) (void)medium_->remove(name_of(found.value()[i]));
  }
  return done;
}

// Not synced: a trial that reappears after a power cut is removed at start.
Status SlotStore::reject() { return medium_->remove(kTrial); }

Status SlotStore::undo(size_t n) {
  const auto found = slots();
  if (!found) return found.error();
  const auto next = next_slot(found.value(), 0);
  if (!next) return next.error();
  const std::string before = name_of(found.value()[n]);
  const std::string undone = name_of(next.value());
  Status done = rename(before, undone);
  if (!done) return done;
  done = sync();
  // Reports failure, so that the next undo repeats it, unless there is no way back.
  if (!done && !rename(undone, before)) return Unit{};
  return done;
}

// Writes the temporary file and reads it back from the medium.
Status SlotStore::write_checked(std::span<const uint8_t> bytes) {
  const Result<bool> cleared = remove_if_present(kIncoming);
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

Result<bool> SlotStore::remove_if_present(const std::string& name) {
  const auto names = medium_->list();
  if (!names) return names.error();
  if (std::find(names.value().begin(), names.value().end(), name) == names.value().end()) return false;
  const Status removed = medium_->remove(name);
  if (!removed) return removed.error();
  return true;
}

}  // namespace ruffini
