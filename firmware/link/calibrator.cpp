#include "link/calibrator.h"

#include <algorithm>

namespace ruffini {
namespace {

uint32_t first_four_bytes(const std::string& hash) {
  uint32_t id = 0;
  for (size_t i = 0; i < 4; ++i) id = id << 8 | static_cast<uint8_t>(hash[i]);
  return id;
}

}  // namespace

Calibrator::Calibrator(const BoardSettings& board, std::string serial, SlotStore store, Exchange& exchange)
    : board_(board), serial_(std::move(serial)), store_(std::move(store)), exchange_(exchange) {}

Result<Calibrator::Prepared> Calibrator::prepare(std::span<const uint8_t> bytes) const {
  auto file = CalibrationFile::load(bytes);
  if (!file) return file.error();
  const Calibration& calibration = file.value()->get();
  auto signer = verify_signature(calibration);
  if (!signer) return signer.error();
  const Status fits = calibration.check_target(board_, serial_);
  if (!fits) return fits.error();
  auto path = FramePath::configure(board_, file.value(), clock_);
  if (!path) return path.error();
  const std::string hash = sha256(bytes);
  path.value()->set_calibration_id(first_four_bytes(hash));
  return Prepared{std::move(path).value(),
                  {true, hash, std::string(calibration.text("created_utc")), std::string(calibration.text("kinds")),
                   signer.value()}};
}

Result<std::unique_ptr<FramePath>> Calibrator::start(ClockFunction clock, std::string& problem) {
  clock_ = clock;
  for (const auto& bytes : {store_.load(), store_.load_previous()}) {
    if (bytes && bytes.value().empty()) break;
    auto prepared = bytes ? prepare(bytes.value()) : Result<Prepared>(bytes.error());
    if (prepared) {
      if (!problem.empty()) problem += "; the calibration before it is in force";
      active_ = prepared.value().calibration;
      return std::move(prepared.value().path);
    }
    problem += (problem.empty() ? "" : "; the one before it: ") + prepared.error().message;
  }
  return FramePath::configure(board_, nullptr, clock);
}

Status Calibrator::begin(uint64_t size_bytes, const std::string& sha256) {
  if (size_bytes == 0 || size_bytes > kMaxUploadBytes || sha256.size() != 32) {
    return Error{ErrorKind::kBadInput, "an upload needs a SHA-256 and 1 byte to 128 MiB: check the tool's version"};
  }
  const bool is_same = is_receiving_ && expected_sha256_ == sha256 && size_bytes_ == size_bytes;
  if (!is_same) {
    upload_.clear();
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
  if (!is_complete()) return Error{ErrorKind::kBadInput, "the upload is not complete: send the missing chunks"};
  if (sha256(upload_) != expected_sha256_) {
    abort();
    return Error{ErrorKind::kStorage, "the upload's SHA-256 differs from what was announced: send it again"};
  }
  auto prepared = prepare(upload_);
  if (!prepared) {
    abort();
    return prepared.error();
  }
  Status installed = store_.install(upload_);
  if (!installed) return installed;
  abort();
  put_in_force(std::move(prepared).value());
  return Unit{};
}

Status Calibrator::undo() {
  const auto before = store_.load_previous();
  if (!before) return before.error();
  if (before.value().empty()) {
    return Error{ErrorKind::kBadInput, "no calibration was in force before this one: flash the file that is wanted"};
  }
  auto prepared = prepare(before.value());
  if (!prepared) return prepared.error();
  Status undone = store_.undo();
  if (undone) put_in_force(std::move(prepared).value());
  return undone;
}

void Calibrator::put_in_force(Prepared prepared) {
  active_ = std::move(prepared.calibration);
  delete exchange_.next_path.exchange(prepared.path.release(), std::memory_order_acq_rel);
}

void Calibrator::abort() {
  is_receiving_ = false;
  upload_.clear();
  upload_.shrink_to_fit();
}

}  // namespace ruffini
