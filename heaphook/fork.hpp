// SPDX-License-Identifier: Apache-2.0
//
// Fork handlers; see fork.cpp.
#pragma once

namespace agnocast::heaphook::fork_rules {

// Register handlers before and after the allocator registers its own: ours enclose them. Return
// false if the system refuses.
bool register_inner();
bool register_outer();

}  // namespace agnocast::heaphook::fork_rules
