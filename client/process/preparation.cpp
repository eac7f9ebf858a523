// SPDX-License-Identifier: Apache-2.0

#include <client/process/preparation.hpp>

#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/user_code.hpp>

#include <mutex>

namespace agnocast {

Result<void> prepare_process() noexcept {
  static constinit std::mutex mutex;
  static constinit bool is_prepared = false;
  const std::lock_guard lock(mutex);
  if (is_prepared) return {};
  if (Result<void> known = recognise_forked_children(); !known) return known;
  if (Result<void> ends = end_user_code_at_exit(); !ends) return ends;
  LibraryThread::be_started_here();
  is_prepared = true;
  return {};
}

}  // namespace agnocast
