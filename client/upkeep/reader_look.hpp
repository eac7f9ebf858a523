// SPDX-License-Identifier: Apache-2.0
//
// ReaderLook: checks the readers of this process's publishers once a second: which of them keep too
// much of its heap (client/shares/reader_shares.hpp), and which cannot be mapped
// (client/shares/unmapped_users.hpp).
#pragma once

#include <client/connection/connection.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/shares/reader_shares.hpp>
#include <client/shares/unmapped_users.hpp>
#include <client/upkeep/own_heap.hpp>

#include <memory>
#include <vector>

namespace agnocast {

/// Control thread.
class ReaderLook {
 public:
  /// Looks, if a second has passed. Allocates.
  void look(const EndpointTable& endpoints, const OwnHeap& heap, Connection& connection);
  const ReaderShares& shares() const noexcept { return shares_; }
  UnmappedUsers& unmapped_users() noexcept { return unmapped_users_; }

 private:
  using Publishers = std::vector<std::shared_ptr<PublisherEndpoint>>;
  void withdraw_above(const OwnHeap& heap, const Publishers& all,
                      ReaderShares::Clock::time_point now);
  void look_at_each(Connection& connection, const Publishers& all,
                    ReaderShares::Clock::time_point now);

  ReaderShares::Clock::time_point looked_{};
  ReaderShares shares_;
  UnmappedUsers unmapped_users_;
};

}  // namespace agnocast
