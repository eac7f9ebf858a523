// SPDX-License-Identifier: Apache-2.0
//
// SharedFd: a descriptor with several holders. A packet in a queue holds the descriptors that it
// will pass on; a bare number could have been closed and reused meanwhile, and the client would
// receive a descriptor that is not its own.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <memory>
#include <utility>

namespace agnocast::daemon {

using SharedFd = std::shared_ptr<const UniqueFd>;

inline SharedFd share(UniqueFd fd) { return std::make_shared<const UniqueFd>(std::move(fd)); }

}  // namespace agnocast::daemon
