#include "infer/inference.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <thread>

namespace ruffini {
namespace {

constexpr int kBuffersInAll = 6;
constexpr int kSide = 4;

// Says the first pixel's B and G; waits for `gate` to be open.
class FirstPixel : public Network {
 public:
  explicit FirstPixel(std::atomic<bool>& gate) : gate_(gate) {}
  bool infer(const FrameView& frame, std::span<float> out) override {
    gate_.wait(false);
    if (out.size() != 2) return false;
    out[0] = frame.data[0] == 255 ? std::nanf("") : static_cast<float>(frame.data[0]);
    out[1] = -static_cast<float>(frame.data[1]);
    return true;
  }

 private:
  std::atomic<bool>& gate_;
};

class InferenceTest : public testing::Test {
 protected:
  void start(bool is_lockstep = true, size_t n_outputs = 2) {
    inference_ = std::make_unique<Inference>(
        [this, n_outputs]() -> Result<LoadedNetwork> {
          NetworkCard card{{"a_un", "b_um", "c_um"}, {0, -100, 0}, {100, 0, 0}, std::string(32, 'h')};
          card.names.resize(n_outputs);
          return LoadedNetwork{std::move(card), std::make_unique<FirstPixel>(gate_)};
        },
        pool_, kBuffersInAll, health_, is_lockstep);
  }
  // A frame whose first pixel is (b, g); it must be free.
  void post(uint8_t b, uint8_t g, uint64_t number, uint32_t flags = 0) {
    const int index = pool_.lend().value();
    pool_[index].pixels[0] = b;
    pool_[index].pixels[1] = g;
    pool_[index].number = number;
    pool_[index].capture_us = 1;
    inference_->post(FrameLease(pool_, index), flags, 7);
  }
  [[nodiscard]] int n_free() {
    std::vector<FrameLease> held;
    while (const auto index = pool_.lend()) held.emplace_back(pool_, *index);
    return static_cast<int>(held.size());
  }

  FramePool pool_{kBuffersInAll, kSide, kSide};
  NetworkHealth health_;
  std::atomic<bool> gate_{true};
  std::unique_ptr<Inference> inference_;
};

TEST_F(InferenceTest, AResultCarriesItsFramesStampAndTheNumbers) {
  start();
  post(40, 50, 9, kSide);
  inference_->wait_idle();
  const LearnedResult* said = inference_->take();
  ASSERT_NE(said, nullptr);
  EXPECT_TRUE(said->is_valid);
  ASSERT_EQ(said->n_values, 2U);
  EXPECT_EQ(said->value[0], 40);
  EXPECT_EQ(said->value[1], -50);
  EXPECT_EQ(said->stamp.frame, 9U);
  EXPECT_EQ(said->stamp.capture_us, 1U);
  EXPECT_EQ(said->stamp.flags, uint32_t{kSide});
  EXPECT_EQ(said->stamp.calibration_id, 7U);
  EXPECT_EQ(said->period_us, 0U);
  EXPECT_GE(said->latency_us, said->took_us);
  EXPECT_EQ(inference_->names()[1], "b_um");
  EXPECT_EQ(inference_->take(), nullptr);
  EXPECT_EQ(health_.state, NetworkState::kRuns);
  EXPECT_EQ(health_.sha256[31], 'h');
  EXPECT_EQ(health_.took_us, said->took_us);
  EXPECT_EQ(health_.latency_us, said->latency_us);
  EXPECT_EQ(n_free(), kBuffersInAll);
}

TEST_F(InferenceTest, WhatWasNotTaughtIsInvalidAndNoNumberIsNone) {
  start();
  post(101, 0, 1);
  inference_->wait_idle();
  const LearnedResult* said = inference_->take();
  EXPECT_FALSE(said->is_valid);
  EXPECT_EQ(said->value[0], 101);
  post(255, 0, 2);
  inference_->wait_idle();
  said = inference_->take();
  EXPECT_FALSE(said->is_valid);
  EXPECT_EQ(said->n_values, 0U);
  post(100, 100, 3);
  inference_->wait_idle();
  EXPECT_TRUE(inference_->take()->is_valid);
  EXPECT_EQ(health_.results, 3U);
  EXPECT_EQ(health_.invalid, 2U);
}

// A network that hangs: posting goes on at once, frames come back, and the newest is what it looks at next.
TEST_F(InferenceTest, ABusyNetworkHoldsTwoFramesAndLooksAtTheNewest) {
  start(false);
  post(1, 0, 1);
  inference_->wait_idle();
  EXPECT_NE(inference_->take(), nullptr);
  gate_ = false;
  post(2, 0, 2);
  while (n_free() < kBuffersInAll - 1) std::this_thread::yield();
  const auto begin = std::chrono::steady_clock::now();
  for (uint8_t i = 3; i < 103; ++i) {
    post(i, 0, i);
    ASSERT_GE(n_free(), kBuffersInAll - Inference::kBuffers);
  }
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
  EXPECT_EQ(inference_->take(), nullptr);
  gate_ = true;
  gate_.notify_all();
  inference_->wait_idle();
  const LearnedResult* said = inference_->take();
  ASSERT_NE(said, nullptr);
  EXPECT_EQ(said->stamp.frame, 102U);
  EXPECT_GE(health_.skipped, 99U);
  EXPECT_EQ(health_.results + health_.skipped, 103U - 1);
  EXPECT_EQ(n_free(), kBuffersInAll);
  std::this_thread::sleep_for(std::chrono::milliseconds(1));
  post(1, 0, 103);
  inference_->wait_idle();
  EXPECT_GE(inference_->take()->period_us, 1'000U);
}

TEST_F(InferenceTest, ANetworkThatDoesNotLoadGivesEveryFrameBack) {
  inference_ = std::make_unique<Inference>(
      []() -> Result<LoadedNetwork> {
        return Error{ErrorKind::kUnavailable, "net.onnx: no such network: put it there"};
      },
      pool_, kBuffersInAll, health_, true);
  for (uint8_t i = 0; i < 20; ++i) {
    post(i, 0, i);
    inference_->wait_idle();
  }
  EXPECT_EQ(inference_->take(), nullptr);
  EXPECT_EQ(n_free(), kBuffersInAll);
  EXPECT_EQ(health_.state, NetworkState::kFailed);
  EXPECT_STREQ(health_.problem.data(), "net.onnx: no such network: put it there");
}

TEST_F(InferenceTest, AnotherNumberOfOutputsIsFoundBeforeTheFirstFrame) {
  start(true, 3);
  while (health_.state == NetworkState::kLoading) std::this_thread::yield();
  EXPECT_EQ(health_.state, NetworkState::kFailed);
  EXPECT_NE(std::string(health_.problem.data()).find("3 outputs"), std::string::npos);
}

TEST_F(InferenceTest, ItEndsWithAFrameWaiting) {
  start(false);
  post(1, 0, 1);
  inference_->wait_idle();
  gate_ = false;
  post(2, 0, 2);
  while (n_free() < kBuffersInAll - 1) std::this_thread::yield();
  post(3, 0, 3);
  std::thread opener([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    gate_ = true;
    gate_.notify_all();
  });
  inference_.reset();
  opener.join();
  EXPECT_EQ(n_free(), kBuffersInAll);
}

}  // namespace
}  // namespace ruffini
