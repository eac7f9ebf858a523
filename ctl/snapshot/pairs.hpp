// SPDX-License-Identifier: Apache-2.0
//
// Pairs: how messages pass between one publisher and one subscription, and why they are lost,
// copied or not delivered. The question "is it zero-copy?" is answered here and nowhere else.
#pragma once

#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::ctl {

enum class PairState : std::uint8_t {
  zero_copy,     // linked; no message was copied into the shared heap
  adopted,       // linked; messages were built outside the shared heap and copied in
  withdrawn,     // the publisher no longer serves the subscription
  unreachable,   // linked; the subscriber uses the messages' addresses and loses them
  joining,       // not linked yet
  incompatible,  // not matched: the requested quality of service is not offered
  ignored,       // not matched: the subscription ignores publishers of its own process
  ending,        // one of them has left or died; unread or held messages remain
  unknown,       // a region cannot be read
};

struct Pair {
  const Endpoint* publisher = nullptr;
  const Endpoint* subscription = nullptr;
  PairState state = PairState::unknown;
  std::string why;  // a sentence; empty: nothing to report
};

/// Returns why the publisher no longer serves the subscription; none: it does, or cannot be read.
abi::Withdrawal withdrawal_of(const System& system, const Endpoint& publisher,
                              const Endpoint& subscription) noexcept;
/// Returns "zero_copy", for programs.
const char* word_of(PairState state) noexcept;
/// Returns whether its messages are not copied; false if it gets none.
inline bool is_zero_copy(PairState state) noexcept { return state == PairState::zero_copy; }
/// Returns "yes", or "no, STATE: why".
std::string answer_of(const Pair& pair);

/// Returns all pairs of a topic, publisher by publisher.
std::vector<Pair> pairs_of(const System& system, const Topic& topic);

}  // namespace agnocast::ctl
