// SPDX-License-Identifier: Apache-2.0
//
// Admission: limits what one user may have, and words the refusal of a request for more.
//
// Each admit function compares the user's entries in the tables with its limits and changes
// nothing. The caller carries the request out afterwards, in the same iteration of the loop.
#pragma once

#include <base/sockets/peer_identity.hpp>
#include <daemon/admission/access_control.hpp>
#include <daemon/config/config.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/descriptor_store.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>
#include <string>
#include <string_view>

namespace agnocast::daemon {

class Admission {
 public:
  Admission(const Config& config, const Arena& arena, const AddressPlan& plan,
            const Registry& registry, const EndpointManager& endpoint_manager,
            const DescriptorStore& store, const AccessControl& access) noexcept
      : config_(config),
        arena_(arena),
        plan_(plan),
        registry_(registry),
        endpoint_manager_(endpoint_manager),
        store_(store),
        access_(access) {}

  /// `counts_as_observer`: the connection was accepted only to observe. Errors: quota_exceeded.
  [[nodiscard]] Result<void> admit_client(std::uint32_t uid, bool counts_as_observer);
  /// `used`: the user's number of observers. Errors: quota_exceeded.
  [[nodiscard]] Result<void> admit_observer(std::uint64_t used);
  /// Checks the number of wait sets. Errors: quota_exceeded.
  [[nodiscard]] Result<void> admit_wait_set(std::uint32_t uid);
  /// Check a new heap window. Errors: window_exhausted, quota_exceeded.
  [[nodiscard]] Result<void> admit_window(const ClientRecord& record);
  [[nodiscard]] Result<void> admit_brought_window(const ClientRecord& record, std::uint64_t bytes);
  /// Checks a creation. Errors: depth_refused, access_denied, readers_differ, quota_exceeded.
  [[nodiscard]] Result<void> admit_endpoint(const PeerIdentity& who, ClientIndex client,
                                            const CreateRequest& request);

  /// A quota that a request would exceed. The log names it in fields of its own.
  struct Exceeded {
    std::string_view limit;  // static text; empty: none was exceeded
    std::uint64_t value = 0, used = 0, asked = 0;
  };
  /// Forgets the quota that the previous request exceeded.
  void begin_request() noexcept { exceeded_ = {}; }
  /// Returns the quota that the current request exceeded, if its error is quota_exceeded.
  const Exceeded& exceeded() const noexcept { return exceeded_; }

  /// Returns why a user with as many clients as [quota] clients allows cannot connect.
  std::string clients_text() const;
  /// Returns the effective [quota] heap_bytes.
  std::uint64_t heap_quota() const noexcept;
  /// Returns how many endpoints of this kind one user may have in a topic with so many places.
  std::uint64_t places_quota(Kind kind, std::uint64_t places = unlimited) const noexcept;

 private:
  [[nodiscard]] Result<void> check_window(std::uint32_t uid, std::uint64_t bytes);
  /// Checks that this user may store `more` more descriptors across a daemon restart.
  [[nodiscard]] Result<void> check_kept(std::uint32_t uid, std::uint64_t more);
  [[nodiscard]] Result<void> check_topics(const ClientRecord& record, const CreateRequest& request);
  [[nodiscard]] Result<void> check_places(const ClientRecord& record, const CreateRequest& request);
  [[nodiscard]] Result<void> check_hold_quota(const ClientRecord& record,
                                              const CreateRequest& request);
  [[nodiscard]] Result<void> check_limit(std::uint64_t used, std::uint64_t more,
                                         std::uint64_t limit, std::string_view name);
  [[nodiscard]] tl::unexpected<Failure> over_quota(const Exceeded& exceeded,
                                                   const std::string& text);

  const Config& config_;
  const Arena& arena_;
  const AddressPlan& plan_;
  const Registry& registry_;
  const EndpointManager& endpoint_manager_;
  const DescriptorStore& store_;
  const AccessControl& access_;
  Exceeded exceeded_;
};

}  // namespace agnocast::daemon
