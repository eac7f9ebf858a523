// SPDX-License-Identifier: Apache-2.0
//
// Refusals: what was refused lately, for people who ask later why something does not work (doctor,
// top, monitor). Pure. The log says the same; this is what a tool can read.
//
// A refusal that comes again is counted, not kept twice. What is kept is bounded, and nobody can
// push out what others were refused: the user who has most loses his oldest.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/error.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::daemon {

class Refusals {
 public:
  // Of all users; twice what a screen shows.
  static constexpr std::size_t count_max = 128;

  struct Refusal {
    Errc code = Errc::internal;
    std::uint32_t uid = 0;
    std::uint32_t pid = 0;
    std::uint64_t domain = 0;
    abi::wire::Kind kind{};    // of what was to be created; 0: nothing of that kind
    std::string process_name;  // empty: it has not said hello
    std::string topic;
    std::string why;
    std::uint64_t stamp_ns = 0;  // CLOCK_MONOTONIC, of the last time
    std::uint64_t times = 1;
  };

  void add(Refusal refusal);
  /// The oldest first.
  const std::vector<Refusal>& all() const noexcept { return all_; }

 private:
  std::vector<Refusal> all_;
};

}  // namespace agnocast::daemon
