// Separate contacts of a field of nodal forces (stages/contacts/contacts.h), and the slip state of each
// (stages/contacts/slip.h).
#include "core/stages.h"
#include "solve/contact_mask.h"
#include "stages/contacts/contacts.h"
#include "stages/contacts/slip.h"

namespace ruffini {
namespace {

class ContactsStage final : public Stage {
 public:
  explicit ContactsStage(const StageContext& c)
      : nodes_(c.board),
        finder_(nodes_, c.board.force_lsb_un,
                contact_threshold_lsb(c.board.contact.threshold_un, c.board.force_lsb_un)),
        tracker_(nodes_, c.board.force_lsb_un),
        solve_(c.slots.read<Slot::kNodeForces>()),
        displacement_(c.slots.read<Slot::kDisplacement>()),
        force_(c.slots.read<Slot::kForceValidity>()),
        contacts_(c.slots.write<Slot::kContacts>()),
        slip_(c.slots.write<Slot::kSlip>()) {
    slip_.node = tracker_.nodes();
  }

  void run(Frame& /*frame*/) override {
    contacts_ = finder_.find(solve_.mask, solve_.force, displacement_.node);
    tracker_.track(contacts_, finder_.component(), solve_.force, displacement_.node);
    slip_.contact = tracker_.contacts();
  }

  void judge(uint32_t& flags) override {
    if ((flags & kWrongFlags) != 0) tracker_.forget();
    if (force_.z == Validity::kValid && contacts_.reaches_border) flags |= kFlagWindowBorder;
  }

  void forget() override { tracker_.forget(); }

 private:
  NodeGrid nodes_;
  ContactFinder finder_;
  SlipTracker tracker_;
  const SlotData<Slot::kNodeForces>& solve_;
  const SlotData<Slot::kDisplacement>& displacement_;
  const SlotData<Slot::kForceValidity>& force_;
  SlotData<Slot::kContacts>& contacts_;
  SlotData<Slot::kSlip>& slip_;
};

}  // namespace

StagePointer make_contacts(const StageContext& context) { return std::make_unique<ContactsStage>(context); }

}  // namespace ruffini
