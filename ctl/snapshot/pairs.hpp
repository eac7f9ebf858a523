// SPDX-License-Identifier: Apache-2.0
//
// Pairs: what becomes of a message between one publisher and one subscription, and why it is not what one
// wants. "Is it zero-copy?" is answered here and nowhere else.
#pragma once

#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::ctl {

enum class PairState : std::uint8_t {
  zero_copy,     // linked; no message had to be copied into the shared heap
  adopted,       // linked; messages were built outside the shared heap and copied in
  withdrawn,     // the publisher serves the subscription no more
  unreachable,   // linked; messages lie where the subscriber has something else, and are lost to it
  joining,       // not linked yet
  incompatible,  // not matched: the quality of service asked for is not offered
  ending,        // one of both has left or died; what is unread or held is still there
  unknown,       // a region cannot be read
};

struct Pair {
  const Endpoint* publisher = nullptr;
  const Endpoint* subscription = nullptr;
  PairState state = PairState::unknown;
  std::string why;  // for people; empty: nothing to say
};

/// Why a publisher serves a subscription no more; none: it serves it, or cannot be read.
abi::Withdrawal withdrawal_of(const System& system, const Endpoint& publisher,
                              const Endpoint& subscription) noexcept;
/// "zero_copy": for programs.
const char* word_of(PairState state) noexcept;
/// Is what it gets not copied? False for what gets nothing.
inline bool is_zero_copy(PairState state) noexcept { return state == PairState::zero_copy; }
/// "yes", or "no: why".
std::string answer_of(const Pair& pair);

/// All pairs of a topic, publisher by publisher.
std::vector<Pair> pairs_of(const System& system, const Topic& topic);

}  // namespace agnocast::ctl
