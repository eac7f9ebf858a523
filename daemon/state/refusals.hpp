// SPDX-License-Identifier: Apache-2.0
//
// Refusals: recent refusals, for people who ask later why something does not work (doctor, top,
// monitor). Pure. The log has the same facts; tools read this.
//
// A repeated refusal is counted, not stored twice. The table is bounded, and no user can push out
// the refusals of others: the user with most entries loses its oldest.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <agnocast/error.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::daemon {

class Refusals {
 public:
  // For all users together; twice what a screen shows.
  static constexpr std::size_t count_max = 128;

  struct Refusal {
    Errc code = Errc::internal;
    std::uint32_t uid = 0;
    std::uint32_t pid = 0;
    std::uint64_t domain = 0;
    abi::wire::Kind kind{};    // of the endpoint to be created; 0: no endpoint
    std::string process_name;  // empty: no hello yet
    std::string topic;
    std::string why;
    std::uint64_t stamp_ns = 0;  // CLOCK_MONOTONIC, of the last one
    std::uint64_t times = 1;
  };

  void add(Refusal refusal);
  /// Returns the refusals, oldest first.
  const std::vector<Refusal>& all() const noexcept { return all_; }

 private:
  std::vector<Refusal> all_;
};

}  // namespace agnocast::daemon
