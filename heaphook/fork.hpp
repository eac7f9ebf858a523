// SPDX-License-Identifier: Apache-2.0
//
// Fork handlers; see fork.cpp.
#pragma once

namespace agnocast::heaphook::fork_rules {

// Before and after the allocator registers its own handlers: ours enclose them. False when the system refused.
bool register_inner();
bool register_outer();

}  // namespace agnocast::heaphook::fork_rules
