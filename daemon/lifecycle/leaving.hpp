// SPDX-License-Identifier: Apache-2.0
//
// Leaving: decides about reports of processes on the end of endpoints: one of their own leaves, it
// has drained, they have unmapped another one. A core without I/O, as endings.hpp.
//
// A client may repeat a request whose answer was lost with the connection. A request that was
// carried out gets the same answer as before (journal/cases.hpp, Q).
#pragma once

#include <agnocast/result.hpp>
#include <daemon/lifecycle/effects.hpp>
#include <daemon/lifecycle/endings.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>

namespace agnocast::daemon {

/// The packets that a connection has brought to its process.
struct Reader {
  const AnnouncementNumbers& announcements;
  std::uint64_t packet_count = 0;      // sent so far
  bool is_being_announced_to = false;  // what existed before it came back, and not all of that yet
};

class Leaving {
 public:
  Leaving(const Registry& registry, const Endings& endings) noexcept
      : registry_(registry), endings_(endings) {}

  /// Return the effects of a request. `final_head` is for a publisher. Errors: protocol_violation.
  [[nodiscard]] Result<Effects> leave(ClientIndex client, const LeaveRequest& request,
                                      std::uint64_t final_head) const;
  [[nodiscard]] Result<Effects> drained(ClientIndex client, const DrainedRequest& request) const;
  [[nodiscard]] Result<Effects> unlinked(ClientIndex client, const wire::Unlinked& statement,
                                         const Reader& reader) const;

  bool is_own(ClientIndex client, const wire::Reference& reference) const;

 private:
  Effects answered_again(ClientIndex client, const wire::Reference& reference) const;
  effect::Send done(ClientIndex client, const wire::Reference& reference) const;
  Effects publisher_drained(ClientIndex client, const wire::Reference& reference) const;
  Effects subscription_drained(ClientIndex client, const wire::Reference& reference) const;
  [[nodiscard]] Result<Effects> region_unlinked(ClientIndex client, const wire::Unlinked& statement,
                                                const Reader& reader) const;
  bool is_active(ClientIndex client, const wire::Reference& reference) const;
  /// Returns whether nothing is left to be drained.
  bool is_drained(ClientIndex client, const wire::Reference& reference) const;
  /// Returns whether the process has another subscription of the topic that reads this publisher.
  bool has_another_reader(ClientIndex client, const EndpointRef& subscription,
                          const PublisherRecord& publisher) const;

  const Registry& registry_;
  const Endings& endings_;
};

}  // namespace agnocast::daemon
