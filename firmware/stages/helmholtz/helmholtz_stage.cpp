// Curl-free and divergence-free parts of the flow of a texture (stages/helmholtz/helmholtz.h).
#include "core/stages.h"
#include "stages/helmholtz/helmholtz.h"

namespace ruffini {
namespace {

class HelmholtzStage final : public Stage {
 public:
  explicit HelmholtzStage(const StageContext& c)
      : helmholtz_(c.board), profile_(c.slots.read<Slot::kProfile>()), sums_(c.slots.write<Slot::kHelmholtz>()) {
    sums_.curl_free = helmholtz_.curl_free();
  }

  void run(Frame& frame) override {
    sums_ = helmholtz_.run(profile_.flow, profile_, frame.saturations);
    sums_.curl_free = helmholtz_.curl_free();
  }

 private:
  Helmholtz helmholtz_;
  const SlotData<Slot::kProfile>& profile_;
  SlotData<Slot::kHelmholtz>& sums_;
};

}  // namespace

StagePointer make_helmholtz(const StageContext& context) { return std::make_unique<HelmholtzStage>(context); }

}  // namespace ruffini
