// Every state that a power cut can leave while the store works, and what the store makes of it afterwards.
//
// The real SlotStore runs on a medium that is watched (support/crash_medium.h). Wherever the power may be cut, each
// content that an unsynced file may have, under each set of names, is a medium of its own, and the real recovery runs
// on that; it may be cut, too. RUFFINI_CRASH_STEP = 1 visits each byte (`make soak`), else each third.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <set>

#include "store/slot_store.h"
#include "support/crash_medium.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::CrashMedium;
using test::Inode;
using test::Names;

constexpr size_t kBytes = 16 << 10;

Bytes table(uint8_t seed) {
  Bytes out(kBytes);
  for (size_t i = 0; i < kBytes; ++i) out[i] = static_cast<uint8_t>((i + 1) * (2 * size_t{seed} + 3) + (i >> 8));
  return out;
}

std::shared_ptr<Inode> kept(Bytes bytes) { return std::make_shared<Inode>(Inode{std::move(bytes), 0, true}); }

size_t step() {
  const char* said = std::getenv("RUFFINI_CRASH_STEP");
  return said == nullptr ? 3 : std::max<size_t>(1, std::strtoul(said, nullptr, 10));
}

// Hands every call on to the watched medium; stores that are broken on purpose leave one out.
struct Medium : Storage {
  explicit Medium(CrashMedium& medium) : below(medium) {}
  [[nodiscard]] Result<std::vector<std::string>> list() const override { return below.list(); }
  [[nodiscard]] Result<Bytes> read(const std::string& name, ReadFrom from) const override {
    return below.read(name, from);
  }
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override {
    return below.create(name, n_bytes);
  }
  [[nodiscard]] Status rename(const std::string& from, const std::string& to) override {
    return below.rename(from, to);
  }
  [[nodiscard]] Status remove(const std::string& name) override { return below.remove(name); }
  [[nodiscard]] Status sync_folder() override { return below.sync_folder(); }
  [[nodiscard]] std::string path(const std::string& name) const override { return below.path(name); }
  CrashMedium& below;  // NOLINT(misc-non-private-member-variables-in-classes): a seam of this test alone
};

// The file's content is never synced.
struct WithoutFileSync final : Medium {
  using Medium::Medium;
  struct Unsynced final : NewFile {
    explicit Unsynced(std::unique_ptr<NewFile> file) : below(std::move(file)) {}
    Status write(std::span<const uint8_t> bytes) override { return below->write(bytes); }
    Status sync() override { return Unit{}; }
    std::unique_ptr<NewFile> below;
  };
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override {
    auto made = below.create(name, n_bytes);
    if (!made) return made.error();
    return std::unique_ptr<NewFile>(std::make_unique<Unsynced>(std::move(made).value()));
  }
};

// The names are never synced.
struct WithoutFolderSync final : Medium {
  using Medium::Medium;
  [[nodiscard]] Status sync_folder() override { return Unit{}; }
};

// Written under its final name at once.
struct InPlace final : Medium {
  using Medium::Medium;
  static constexpr char kFinal[] = "calibration-9.safetensors";
  static std::string placed(const std::string& name) { return name == "incoming.tmp" ? kFinal : name; }
  [[nodiscard]] Result<Bytes> read(const std::string& name, ReadFrom from) const override {
    return below.read(placed(name), from);
  }
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override {
    return below.create(placed(name), n_bytes);
  }
  [[nodiscard]] Status rename(const std::string& from, const std::string& to) override {
    return from == "trial.safetensors" || from == "incoming.tmp" ? Status(Unit{}) : below.rename(from, to);
  }
  [[nodiscard]] Status remove(const std::string& name) override {
    return below.remove(name == "trial.safetensors" && below.names().count(name) == 0 ? kFinal : name);
  }
};

enum class Work { kConfirm, kReject, kUndo };

struct Scenario {
  const char* name;
  Names before;
  Work work;
  Bytes old_one;  // in force before; empty: nothing
  Bytes new_one;  // flashed, or put back
  uint32_t old_epoch = 0;
  uint32_t new_epoch = 0;
};

// What has been asked for, and said to be done.
struct Progress {
  bool may_be_new = false;
  bool must_be_new = false;
};

std::vector<Scenario> scenarios() {
  const Names two = {{"calibration-3.safetensors", kept(table(3))}, {"calibration-4.safetensors", kept(table(4))}};
  Names crowded = two;  // a cut kept an older one, a trial, and half an upload
  crowded["calibration-2.safetensors"] = kept(table(2));
  crowded["incoming.tmp"] = kept(Bytes(100, 7));
  crowded["trial.safetensors"] = kept(table(6));
  const Names raised = {{"calibration-3.safetensors", kept(table(3))},
                        {"calibration-4.epoch-1.safetensors", kept(table(4))}};
  return {
      {"first flash", {}, Work::kConfirm, {}, table(5)},
      {"second flash", {{"calibration-1.safetensors", kept(table(4))}}, Work::kConfirm, table(4), table(5)},
      {"upgrade", two, Work::kConfirm, table(4), table(5)},
      {"upgrade after a cut", crowded, Work::kConfirm, table(4), table(5)},
      {"the same file again", two, Work::kConfirm, table(4), table(4)},
      {"a trial that fails", two, Work::kReject, table(4), table(5)},
      {"undo", two, Work::kUndo, table(4), table(3)},
      {"a higher epoch", raised, Work::kConfirm, table(4), table(5), 1, 3},
      {"a flash after a higher epoch", raised, Work::kConfirm, table(4), table(5), 1, 1},
      {"undo after a higher epoch", raised, Work::kUndo, table(4), table(3), 1, 1},
  };
}

struct Tally {
  bool ends_at_first_wrong = false;
  size_t n_states = 0;
  size_t n_wrong = 0;
  std::string first_wrong;
  [[nodiscard]] bool is_ended() const { return ends_at_first_wrong && n_wrong > 0; }
};

class Visitor {
 public:
  Visitor(const Scenario& scenario, Tally& tally) : scenario_(scenario), tally_(tally) {}

  // All that a cut at this moment may leave.
  void cut(const CrashMedium& medium, Progress progress) {
    for (size_t n = 0; n <= medium.n_pending() && !tally_.is_ended(); ++n) {
      const Names names = medium.names_after(n);
      const auto unsynced =
          std::find_if(names.begin(), names.end(), [](const auto& e) { return !e.second->is_synced; });
      if (unsynced == names.end()) {
        recover(names, progress, true);
        continue;
      }
      torn(*unsynced->second, step(), [&](const Bytes& left) {
        Names here = names;
        here[unsynced->first] = kept(left);
        recover(here, progress, true);
      });
    }
  }

 private:
  // The start after a cut, which may itself be cut.
  void recover(const Names& names, Progress progress, bool may_be_cut) {
    if (tally_.is_ended()) return;
    ++tally_.n_states;
    CrashMedium medium(names);
    std::set<Names> again;
    if (may_be_cut) {
      medium.watch = [&](const CrashMedium& m) {
        for (size_t n = 0; n <= m.n_pending(); ++n) again.insert(m.names_after(n));
      };
    }
    SlotStore store = SlotStore::open(std::make_unique<Medium>(medium));
    if (!store.problem().empty()) return wrong("cannot be opened: " + store.problem());
    judge(store, progress);
    for (const Names& left : again) recover(left, progress, false);
  }

  void judge(SlotStore& store, Progress progress) {
    const auto now = store.load();
    if (!now) return wrong("cannot be read: " + now.error().message);
    const bool is_new = progress.may_be_new && now.value() == scenario_.new_one;
    if (!is_new && (progress.must_be_new || now.value() != scenario_.old_one)) {
      return wrong("another file is in force");
    }
    if (is_new && scenario_.old_one != scenario_.new_one && store.load(1).value() != scenario_.old_one) {
      return wrong("the file before is lost");
    }
    if (store.epoch().value() != (is_new ? scenario_.new_epoch : scenario_.old_epoch)) {
      return wrong("another security epoch holds");
    }
  }

  void wrong(const std::string& what) {
    if (tally_.n_wrong++ == 0) tally_.first_wrong = std::string(scenario_.name) + ": " + what;
  }

  const Scenario& scenario_;
  Tally& tally_;
};

template <typename Kind>
Tally visit(bool ends_at_first_wrong = false) {
  Tally tally;
  tally.ends_at_first_wrong = ends_at_first_wrong;
  for (const Scenario& scenario : scenarios()) {
    if (tally.is_ended()) break;
    CrashMedium medium(scenario.before);
    Visitor visitor(scenario, tally);
    SlotStore store = SlotStore::open(std::make_unique<Kind>(medium));
    Progress progress{.may_be_new = scenario.work == Work::kUndo};
    medium.watch = [&](const CrashMedium& m) { visitor.cut(m, progress); };
    if (scenario.work == Work::kUndo) {
      EXPECT_TRUE(store.undo());
    } else {
      EXPECT_TRUE(store.stage(scenario.new_one)) << scenario.name;
      progress.may_be_new = scenario.work == Work::kConfirm;
      EXPECT_TRUE(progress.may_be_new ? store.confirm(scenario.new_epoch) : store.reject()) << scenario.name;
    }
    progress.must_be_new = progress.may_be_new;
    visitor.cut(medium, progress);
  }
  return tally;
}

TEST(CrashStates, TheOldFileOrTheNewOneIsInForceWhole) {
  const Tally tally = visit<Medium>();
  EXPECT_EQ(tally.n_wrong, 0U) << tally.first_wrong;
  std::printf("%zu crash states of tables of %zu bytes, each %zu bytes\n", tally.n_states, kBytes, step());
  EXPECT_GE(tally.n_states * step(), 3'000'000U) << "fewer moments are visited than were";
}

// The harness sees each of them. One wrong state shows it; all are counted if RUFFINI_CRASH_STEP is set.
// A confirmation whose sync failed, then a restart without a power cut: what that start finds in force stays so.
TEST(CrashStates, WhatAStartFindsInForceIsDurable) {
  CrashMedium medium({{"calibration-1.safetensors", kept(table(1))}, {"trial.safetensors", kept(table(2))}});
  ASSERT_TRUE(medium.rename("trial.safetensors", "calibration-2.safetensors"));
  SlotStore store = SlotStore::open(std::make_unique<Medium>(medium));
  EXPECT_EQ(store.problem(), "");
  ASSERT_EQ(store.load().value(), table(2));
  CrashMedium after(medium.names_after(0));
  EXPECT_EQ(SlotStore::open(std::make_unique<Medium>(after)).load().value(), table(2));
}

TEST(CrashStates, StoresThatAreBrokenOnPurposeAreCaught) {
  const bool is_quick = std::getenv("RUFFINI_CRASH_STEP") == nullptr;
  const Tally file = visit<WithoutFileSync>(is_quick);
  EXPECT_GT(file.n_wrong, 0U) << "the file is not synced";
  const Tally folder = visit<WithoutFolderSync>(is_quick);
  EXPECT_GT(folder.n_wrong, 0U) << "the folder is not synced";
  const Tally in_place = visit<InPlace>(is_quick);
  EXPECT_GT(in_place.n_wrong, 0U) << "written in place";
  if (is_quick) return;
  std::printf("wrong states: without file sync %zu, without folder sync %zu, in place %zu\n", file.n_wrong,
              folder.n_wrong, in_place.n_wrong);
}

}  // namespace
}  // namespace ruffini
