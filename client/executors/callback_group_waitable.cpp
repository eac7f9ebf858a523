// SPDX-License-Identifier: Apache-2.0

#include <agnocast/callback_group_waitable.hpp>

#include <client/executors/executor_state.hpp>

namespace agnocast {

struct CallbackGroupWaitable::State {
  const std::shared_ptr<ExecutorCore> core = Executor::State::make_core();
  CoreGroups groups{*core};
};

CallbackGroupWaitable::CallbackGroupWaitable(CallbackGroup& group)
    : state_(std::make_unique<State>()) {
  state_->core->share(true);
  if (Result<void> claimed = callback_groups::claim_group(group, state_->groups); !claimed)
    throw Error(claimed.error());
}

CallbackGroupWaitable::~CallbackGroupWaitable() {
  if (is_forked_child()) {
    (void)state_.release();  // threads of the parent may be in there
  } else {
    callback_groups::release_all(state_->groups);
  }
}

int CallbackGroupWaitable::fd() const noexcept { return state_->core->fd(); }

bool CallbackGroupWaitable::prepare() noexcept {
  if (is_forked_child()) return false;
  state_->core->finish_sleep();
  return state_->core->prepare();
}

std::size_t CallbackGroupWaitable::ready_count() const noexcept {
  return is_forked_child() ? 0 : state_->core->ready_count();
}

bool CallbackGroupWaitable::run_one() { return !is_forked_child() && state_->core->run_oldest(); }

}  // namespace agnocast
