#include "link/calibrator.h"

#include <algorithm>
#include <array>
#include <functional>
#include <utility>

#include "store/huge_pages.h"

namespace ruffini {
namespace {

constexpr size_t kStored = 2;    // stored files that a start tries
constexpr size_t kMaxTried = 8;  // stored files that an undo tries

uint32_t first_four_bytes(const std::string& hash) {
  uint32_t id = 0;
  for (size_t i = 0; i < 4; ++i) id = id << 8 | static_cast<uint8_t>(hash[i]);
  return id;
}

struct FlagWord {
  uint32_t flag;
  const char* word;
};
constexpr std::array<FlagWord, 11> kFlagWords = {{{kFlagNoReference, "no rest image"},
                                                  {kFlagMarkersLost, "markers lost"},
                                                  {kFlagSaturated, "saturated numbers"},
                                                  {kFlagOverRange, "over range"},
                                                  {kFlagDark, "dark"},
                                                  {kFlagOverexposed, "overexposed"},
                                                  {kFlagLight, "changed light"},
                                                  {kFlagFeatures, "features of no wrench"},
                                                  {kFlagOtherPad, "another pad"},
                                                  {kFlagRepeated, "the same picture again"},
                                                  {kFlagPicture, "no whole picture"}}};

std::string words_of(uint32_t flags) {
  std::string words;
  for (const FlagWord& f : kFlagWords) {
    if ((flags & f.flag) == 0) continue;
    if (!words.empty()) words += ", ";
    words += f.word;
  }
  return words;
}

}  // namespace

Calibrator::Calibrator(const BoardSettings& board, std::string serial, SlotStore store, Exchange& exchange,
                       TrialRule rule, KeyRing keys)
    : board_(board),
      serial_(std::move(serial)),
      store_(std::move(store)),
      exchange_(exchange),
      rule_(rule),
      keys_(std::move(keys)) {}

Result<Calibrator::Prepared> Calibrator::prepare(std::vector<uint8_t> bytes) const {
  auto file = CalibrationFile::load(std::move(bytes));
  if (!file) return file.error();
  const Calibration& calibration = file.value()->get();
  auto signer = keys_.verify(calibration);
  if (!signer) return signer.error();
  const Status fits = calibration.check_target(board_, serial_);
  if (!fits) return fits.error();
  const auto manifest = read_manifest(calibration);
  if (!manifest) return manifest.error();
  const auto epoch = store_.epoch();
  if (!epoch) return epoch.error();
  const Status is_fresh = check_epoch(manifest.value(), epoch.value());
  if (!is_fresh) return is_fresh.error();
  auto path = FramePath::configure(board_, file.value(), clock_);
  if (!path) return path.error();
  const std::string hash = sha256(file.value()->bytes());
  path.value()->set_calibration_id(first_four_bytes(hash));
  return Prepared{std::move(path).value(),
                  {true, hash, std::string(calibration.text("created_utc")), std::string(calibration.text("kinds")),
                   std::string(calibration.text("gates")), signer.value(), manifest.value(), file.value()}};
}

Result<std::unique_ptr<FramePath>> Calibrator::start(ClockFunction clock, std::string& problem) {
  clock_ = clock;
  Prepared prepared = prepare_stored();
  if (store_.has_discarded_trial()) {
    if (!problem_.empty()) problem_ += "; ";
    problem_ += "the last flash was on trial when the power went: flash it again; what was before is in force";
  }
  if (!store_.problem().empty()) problem_ += (problem_.empty() ? "" : "; ") + store_.problem();
  problem = this->problem();
  active_ = std::move(prepared.calibration);
  return std::move(prepared.path);
}

Result<std::unique_ptr<FramePath>> Calibrator::start_safe(ClockFunction clock, std::string& problem) {
  clock_ = clock;
  problem = problem_ =
      "the last runs crashed soon after their start, so no calibration is used: flash it again, or restart the daemon "
      "to try the stored one";
  return FramePath::configure(board_, nullptr, clock_);
}

Calibrator::Prepared Calibrator::prepare_stored() {
  problem_.clear();
  struct Source {
    const char* name;
    std::function<Result<std::vector<uint8_t>>()> load;
  };
  const std::array<Source, 3> sources = {{{"stored calibration", [this] { return store_.load(0); }},
                                          {"the one before it", [this] { return store_.load(1); }},
                                          {"the factory's", [this] { return factory_; }}}};
  active_index_ = 0;
  for (size_t i = 0; i < sources.size(); ++i) {
    const Source& source = sources[i];
    auto bytes = source.load();
    if (bytes && bytes.value().empty()) continue;
    auto prepared = bytes ? prepare(std::move(bytes).value()) : Result<Prepared>(bytes.error());
    if (prepared) {
      if (!problem_.empty()) problem_ += std::string("; ") + source.name + " is in force";
      active_index_ = i < kStored ? i : 0;
      return std::move(prepared).value();
    }
    problem_ += std::string(problem_.empty() ? "" : "; ") + source.name + " not used: " + prepared.error().message;
  }
  // Cannot fail: without a calibration there are no tables
  return {FramePath::configure(board_, nullptr, clock_).value(), {}};
}

Status Calibrator::begin(uint64_t size_bytes, const std::string& sha256) {
  if (size_bytes == 0 || size_bytes > kMaxUploadBytes || sha256.size() != 32) {
    return Error{ErrorKind::kBadInput, "an upload needs a SHA-256 and 1 byte to 128 MiB: check the tool's version"};
  }
  const Status can_write = store_.can_write();
  if (!can_write) return can_write;
  const bool is_same = is_receiving_ && expected_sha256_ == sha256 && size_bytes_ == size_bytes;
  if (!is_same) {
    std::vector<uint8_t>().swap(upload_);  // gives the memory back before more is asked for
    upload_.reserve(size_bytes);           // growing would take up to three times the memory
    expected_sha256_ = sha256;
    size_bytes_ = size_bytes;
  }
  is_receiving_ = true;
  return Unit{};
}

Status Calibrator::chunk(uint64_t offset, std::span<const uint8_t> data) {
  if (!is_receiving_) return Error{ErrorKind::kBadInput, "no upload was begun: send flash_begin first"};
  if (offset != upload_.size() || data.empty() || data.size() > size_bytes_ - upload_.size()) {
    return Error{ErrorKind::kBadInput, "the chunk does not start at the next offset: continue where the reply says"};
  }
  upload_.insert(upload_.end(), data.begin(), data.end());
  return Unit{};
}

Status Calibrator::commit() {
  if (is_on_trial_) {
    return Error{ErrorKind::kUnavailable, "another calibration is on trial: wait for its end, or undo it"};
  }
  if (!is_complete()) return Error{ErrorKind::kBadInput, "the upload is not complete: send the missing chunks"};
  if (sha256(upload_) != expected_sha256_) {
    abort();
    return Error{ErrorKind::kStorage, "the upload's SHA-256 differs from what was announced: send it again"};
  }
  std::vector<uint8_t> copy = bytes_in_huge_pages(upload_.size());  // a commit that the medium fails may be repeated
  std::copy(upload_.begin(), upload_.end(), copy.begin());
  auto prepared = prepare(std::move(copy));
  if (!prepared) {
    abort();
    return prepared.error();
  }
  const Manifest manifest = prepared.value().calibration.manifest;
  const auto epoch = store_.epoch();
  if (!epoch) return epoch.error();
  const Status follows = check_succession(manifest, active_.manifest.version, epoch.value());
  if (!follows) {
    abort();
    return follows;
  }
  Status stored = store_.stage(upload_);
  if (!stored) return stored;
  if (rule_.n_good == 0) {
    const Status confirmed = store_.confirm(manifest.epoch, active_index_);
    if (!confirmed && store_.is_durable()) return confirmed;
    active_index_ = 0;
  }
  abort();
  problem_.clear();
  activate(std::move(prepared).value());
  is_on_trial_ = rule_.n_good != 0;
  return Unit{};
}

PathTally Calibrator::tally() const {
  const PathTally tally = exchange_.tally;
  const bool is_active = active_.is_present && tally.calibration_id == first_four_bytes(active_.sha256);
  return is_active ? tally : PathTally{};  // otherwise the frame thread has not taken it over yet
}

std::optional<TrialEnd> Calibrator::poll() {
  if (!is_on_trial_) return std::nullopt;
  const PathTally now = tally();
  if (now.n_good >= rule_.n_good) return confirm();
  if (now.n_frames < rule_.n_frames) return std::nullopt;
  const std::string why =
      "the new calibration was on trial, and " + std::to_string(now.n_good) + " of " + std::to_string(now.n_frames) +
      " frames were good (" + words_of(exchange_.wrong_flags) +
      "): what was before is in force again; see that its light is on and nothing is before the lens, and flash again";
  revert();
  problem_ = why + (problem_.empty() ? "" : "; " + problem_);
  return TrialEnd{false, false, problem_};
}

TrialEnd Calibrator::confirm() {
  const Status confirmed = store_.confirm(active_.manifest.epoch, active_index_);
  is_on_trial_ = false;
  if (!confirmed && store_.is_durable()) {  // the medium still has it on trial
    revert();
    problem_ = confirmed.error().message + "; what was before is in force again";
    return {false, false, problem_};
  }
  active_index_ = 0;
  if (!confirmed) return {false, true, problem()};
  return {true, true, "the new calibration is in force"};
}

std::string Calibrator::problem() const {
  const std::string unsynced = store_.unsynced();
  return problem_ + (problem_.empty() || unsynced.empty() ? "" : "; ") + unsynced;
}

void Calibrator::revert() {
  is_on_trial_ = false;
  (void)store_.reject();  // a file that remains is removed at the next start
  activate(prepare_stored());
}

Status Calibrator::undo() {
  if (is_on_trial_) {
    revert();
    return Unit{};
  }
  // The newest usable file before them: a power cut may have left a damaged one in between.
  std::optional<Error> why;
  for (size_t n = active_index_ + 1;; ++n) {
    auto before = store_.load(n);
    if (before && before.value().empty()) break;
    auto prepared = before ? prepare(std::move(before).value()) : Result<Prepared>(before.error());
    if (prepared) {
      Status undone = store_.undo(n);
      if (!undone) return undone;
      active_index_ = 0;
      activate(std::move(prepared).value());
      return undone;
    }
    if (!why) why = prepared.error();
    if (n > kMaxTried) break;  // the medium cannot even be listed
  }
  if (why) return *why;
  return Error{ErrorKind::kBadInput, "no calibration was in force before this one: flash the file that is wanted"};
}

void Calibrator::activate(Prepared prepared) {
  active_ = std::move(prepared.calibration);
  exchange_.tally = PathTally{};
  delete exchange_.next_path.exchange(prepared.path.release(), std::memory_order_acq_rel);
}

void Calibrator::abort() {
  is_receiving_ = false;
  upload_.clear();
  upload_.shrink_to_fit();
}

}  // namespace ruffini
