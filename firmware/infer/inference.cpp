#include "infer/inference.h"

#include <pthread.h>
#include <sched.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>

namespace ruffini {
namespace {

constexpr float kLargest = 1e15F;  // fits int64 in any unit

uint64_t now_us() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch())
          .count());
}

uint32_t since(uint64_t then_us, uint64_t now) {
  return static_cast<uint32_t>(std::min<uint64_t>(now > then_us ? now - then_us : 0, UINT32_MAX));
}

// Sets idle scheduling. Without SCHED_IDLE the network runs as an ordinary thread.
void run_when_idle() {
  const sched_param none{};
  (void)pthread_setschedparam(pthread_self(), SCHED_IDLE, &none);
}

}  // namespace

Inference::Inference(NetworkLoader loader, FramePool& pool, int n_buffers, NetworkHealth& health, bool is_lockstep,
                     std::function<void()> on_thread_start)
    : loader_(std::move(loader)),
      pool_(pool),
      health_(health),
      is_lockstep_(is_lockstep),
      on_thread_start_(std::move(on_thread_start)),
      stamp_(static_cast<size_t>(n_buffers)),
      thread_([this] { loop(); }) {}

Inference::~Inference() {
  if (const std::optional<int> left = mailbox_.close()) pool_.give_back(*left);
  thread_.join();
}

void Inference::post(FrameLease lease, uint32_t flags, uint32_t calibration_id) {
  if (health_.state.load(std::memory_order_acquire) == NetworkState::kFailed) return;
  const LearnedStamp stamp{lease.capture_us(), lease.number(), flags, calibration_id};
  const int index = lease.release();
  stamp_[static_cast<size_t>(index)] = stamp;
  n_pending_.fetch_add(1, std::memory_order_relaxed);
  if (const std::optional<int> back = mailbox_.post(index)) {
    pool_.give_back(*back);
    health_.skipped.fetch_add(1, std::memory_order_relaxed);
    settle();
  }
}

void Inference::wait_idle() const {
  for (int n = n_pending_.load(std::memory_order_acquire); n > 0; n = n_pending_.load(std::memory_order_acquire)) {
    n_pending_.wait(n, std::memory_order_acquire);
  }
}

void Inference::settle() {
  n_pending_.fetch_sub(1, std::memory_order_acq_rel);
  n_pending_.notify_all();
}

void Inference::loop() {
  if (on_thread_start_) on_thread_start_();
  if (!is_lockstep_) run_when_idle();
  if (const Status loaded = load(); loaded) {
    health_.state.store(NetworkState::kRuns, std::memory_order_release);
  } else {
    const std::string& why = loaded.error().message;
    std::copy_n(why.begin(), std::min(why.size(), health_.problem.size() - 1), health_.problem.begin());
    std::fprintf(stderr, "ruffinid: network not used: %s\n", why.c_str());
    health_.state.store(NetworkState::kFailed, std::memory_order_release);
  }
  while (true) {
    mailbox_.wait_full();
    const std::optional<int> index = mailbox_.take();
    if (!index) {
      if (mailbox_.is_closed()) return;
      continue;
    }
    if (FrameLease lease(pool_, *index); network_ != nullptr) infer(lease, stamp_[static_cast<size_t>(*index)]);
    settle();
  }
}

Status Inference::load() {
  Result<LoadedNetwork> loaded = loader_();
  if (!loaded) return loaded.error();
  card_ = std::move(loaded.value().card);
  raw_.resize(card_.names.size());
  const FrameView any = pool_.view(0);  // its content is irrelevant
  const std::vector<uint8_t> empty(static_cast<size_t>(any.stride * any.height));
  if (!loaded.value().network->infer({empty.data(), any.width, any.height, any.channels, any.stride}, raw_)) {
    return Error{ErrorKind::kBadInput, "the network does not run on this board's frames, or has not the " +
                                           std::to_string(raw_.size()) +
                                           " outputs that its metadata names: export it again"};
  }
  std::copy_n(card_.sha256.begin(), std::min(card_.sha256.size(), health_.sha256.size()), health_.sha256.begin());
  network_ = std::move(loaded.value().network);
  return Unit{};
}

void Inference::infer(const FrameLease& lease, const LearnedStamp& stamp) {
  LearnedResult& out = results_.draft();
  const uint64_t begin_us = now_us();
  const bool has_numbers = network_->infer(lease.view(), raw_) && std::all_of(raw_.begin(), raw_.end(), [](float v) {
                             return std::isfinite(v) && std::abs(v) < kLargest;
                           });
  const uint64_t end_us = now_us();
  out.stamp = stamp;
  out.is_valid = has_numbers;
  out.n_values = has_numbers ? raw_.size() : 0;
  for (size_t i = 0; i < out.n_values; ++i) {
    out.value[i] = std::llround(raw_[i]);
    out.is_valid = out.is_valid && out.value[i] >= card_.low[i] && out.value[i] <= card_.high[i];
  }
  out.took_us = since(begin_us, end_us);
  out.latency_us = since(stamp.capture_us, end_us);
  out.period_us = result_us_ == 0 ? 0 : since(result_us_, end_us);
  result_us_ = end_us;
  if (!out.is_valid) health_.invalid.fetch_add(1, std::memory_order_relaxed);
  health_.took_us.store(out.took_us, std::memory_order_relaxed);
  health_.latency_us.store(out.latency_us, std::memory_order_relaxed);
  health_.period_us.store(out.period_us, std::memory_order_relaxed);
  health_.results.fetch_add(1, std::memory_order_relaxed);
  results_.publish();
}

}  // namespace ruffini
