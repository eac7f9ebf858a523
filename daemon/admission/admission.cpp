// SPDX-License-Identifier: Apache-2.0
//
// Admission: see the header.

#include <daemon/admission/admission.hpp>

namespace agnocast::daemon {

namespace {

// A region and a pidfd.
constexpr std::uint64_t kept_per_client = 2;

}  // namespace

std::string Admission::clients_text() const {
  return "[quota] clients is " + std::to_string(config_.quota.clients) + ", this user has as many";
}

std::uint64_t Admission::heap_quota() const noexcept {
  const std::uint64_t quota = config_.quota.heap_bytes;
  return quota != 0 ? quota : share_of_one_user(plan_.window_count()) * arena_.window_bytes;
}

std::uint64_t Admission::places_quota(Kind kind, std::uint64_t places) const noexcept {
  const auto& quota = config_.quota;
  const auto& limits = config_.limits;
  const std::uint64_t configured =
      kind == Kind::publisher ? quota.publishers_per_topic : quota.subscriptions_per_topic;
  if (configured == unlimited) return configured;
  const std::uint64_t all = std::min<std::uint64_t>(
      kind == Kind::publisher ? limits.publishers_per_topic : limits.subscriptions_per_topic,
      places);
  const std::uint64_t share = share_of_one_user(all);
  // A number that was meant for wide topics leaves others no place in a topic with fewer.
  if (configured != 0) return configured < all ? configured : share;
  return share < all ? share : unlimited;
}

Result<void> Admission::admit_client(std::uint32_t uid, bool counts_as_observer) {
  // Further connections are only for processes that come back. Gone processes count as long as
  // others have their memory mapped.
  const std::uint64_t quota = config_.quota.clients;
  const std::uint64_t used = registry_.accounts().usage_of(uid).clients;
  if (counts_as_observer || used >= quota)
    return over_quota({"[quota] clients", quota, used, 1}, clients_text());
  return check_kept(uid, kept_per_client);
}

Result<void> Admission::admit_observer(std::uint64_t used) {
  if (used < abi::observer_count_max) return {};
  return over_quota({"observers", abi::observer_count_max, used, 1},
                    "this user may have " + std::to_string(abi::observer_count_max) + " observers");
}

Result<void> Admission::admit_wait_set(std::uint32_t uid) {
  if (auto kept = check_kept(uid, 1); !kept) return kept;
  return check_limit(registry_.accounts().usage_of(uid).wait_sets, 1, config_.quota.wait_sets,
                     "[quota] wait_sets");
}

Result<void> Admission::admit_window(const ClientRecord& record) {
  if (record.window_count >= config_.heap.windows_per_process)
    return fail_with(Errc::window_exhausted, "[heap] windows_per_process is " +
                                                 std::to_string(config_.heap.windows_per_process) +
                                                 ", this process has as many");
  return check_window(record.uid, arena_.window_bytes);
}

Result<void> Admission::admit_brought_window(const ClientRecord& record, std::uint64_t bytes) {
  if (record.window_count >= config_.heap.windows_per_process)
    return fail_with(Errc::window_exhausted, "[heap] windows_per_process is " +
                                                 std::to_string(config_.heap.windows_per_process));
  return check_window(record.uid, bytes);
}

Result<void> Admission::admit_endpoint(const PeerIdentity& who, ClientIndex client,
                                       const CreateRequest& request) {
  const ClientRecord& record = registry_.client(client);
  if (request.qos.depth > config_.limits.depth_max)
    return fail_with(Errc::depth_refused,
                     "[limits] depth_max is " + std::to_string(config_.limits.depth_max) +
                         ", depth " + std::to_string(request.qos.depth) + " is asked for");
  const bool publisher = request.kind == Kind::publisher;
  if (auto allowed = access_.check_endpoint(who, client, request); !allowed) return allowed;
  if (auto allowed = check_topics(record, request); !allowed) return allowed;
  const Usage usage = registry_.accounts().usage_of(record.uid);
  auto allowed =
      publisher ? check_limit(usage.publishers, 1, config_.quota.publishers, "[quota] publishers")
                : check_limit(usage.subscriptions, 1, config_.quota.subscriptions,
                              "[quota] subscriptions");
  if (!allowed) return allowed;
  if (allowed = check_places(record, request); !allowed) return allowed;
  if (!publisher) {
    allowed = check_limit(usage.held_messages, request.quota, config_.quota.held_messages,
                          "[quota] held_messages");
    if (!allowed) return allowed;
    if (allowed = check_hold_quota(record, request); !allowed) return allowed;
  }
  return {};
}

Result<void> Admission::check_window(std::uint32_t uid, std::uint64_t bytes) {
  if (auto kept = check_kept(uid, 1); !kept) return kept;
  return check_limit(registry_.accounts().usage_of(uid).heap_bytes, bytes, heap_quota(),
                     "[quota] heap_bytes");
}

Result<void> Admission::check_kept(std::uint32_t uid, std::uint64_t more) {
  if (!store_.keeps()) return {};
  const Usage usage = registry_.accounts().usage_of(uid);
  return check_limit(kept_per_client * usage.clients + usage.windows + usage.wait_sets, more,
                     share_of_one_user(store_.capacity()),
                     "three quarters of FileDescriptorStoreMax");
}

// Counts existing topics too: a process that joins one keeps it there when the others have left.
Result<void> Admission::check_topics(const ClientRecord& record, const CreateRequest& request) {
  const auto known = registry_.find_topic(request.domain.value_or(record.domain), request.topic);
  if (known && registry_.accounts().takes_part(record.uid, *known)) return {};
  return check_limit(registry_.accounts().usage_of(record.uid).topics, 1, config_.quota.topics,
                     "[quota] topics");
}

Result<void> Admission::check_places(const ClientRecord& record, const CreateRequest& request) {
  const auto known = registry_.find_topic(request.domain.value_or(record.domain), request.topic);
  if (!known) return {};
  const Places used = registry_.accounts().user_places(record.uid, *known);
  if (request.kind == Kind::subscription)
    return check_limit(used.subscriptions, 1, places_quota(Kind::subscription),
                       "[quota] subscriptions_per_topic");
  const std::uint64_t places = registry_.topic(*known).link_blocks * abi::link_block_count;
  const std::uint64_t quota = places_quota(Kind::publisher, places);
  auto allowed = check_limit(used.publishers, 1, quota, "[quota] publishers_per_topic");
  // More for one user would leave others none.
  const std::uint64_t configured = config_.quota.publishers_per_topic;
  if (!allowed && places < config_.limits.publishers_per_topic &&
      (configured == 0 || configured >= places))
    allowed = fail_with(allowed.error().code,
                        "one user may have " + std::to_string(quota) + " of the " +
                            std::to_string(places) +
                            " publishers of a topic that began without being in [limits] "
                            "wide_topics");
  if (!allowed)
    return endpoint_manager_.endings().explain_full(*known, allowed.error(), record.uid);
  return {};
}

// Refuses a number that the user has set and that no existing publisher can grant. With a
// publisher of its own user the number holds for that one, so a user who publishes too is not kept
// out.
Result<void> Admission::check_hold_quota(const ClientRecord& record, const CreateRequest& request) {
  const auto known = registry_.find_topic(request.domain.value_or(record.domain), request.topic);
  if (request.quota_or_less || !known) return {};
  const HoldPool pool = registry_.hold_pool();
  const HoldPool::Use use = registry_.pool_use(record.uid, *known);
  const std::uint64_t at_most = pool.at_most(use);
  if (request.quota <= at_most) return {};
  bool any = false, own = false;
  registry_.for_each_publisher(*known, [&](std::uint32_t, const PublisherRecord& publisher) {
    if (publisher.state != EndpointState::active) return;
    any = true;
    own = own || registry_.client(publisher.client).uid == record.uid;
  });
  if (!any || own) return {};
  return over_quota(
      {"hold_quota", at_most, use.user + use.others, request.quota},
      "the publishers of " + request.topic + " belong to other users and have " +
          std::to_string(at_most) + " messages left for one more subscription of user " +
          std::to_string(record.uid) + ": ask for a hold_quota of at most that, not " +
          std::to_string(request.quota));
}

Result<void> Admission::check_limit(std::uint64_t used, std::uint64_t more, std::uint64_t limit,
                                    std::string_view name) {
  if (used <= limit && more <= limit - used) return {};
  return over_quota({name, limit, used, more},
                    std::string(name) + " is " + std::to_string(limit) + ", this user has " +
                        std::to_string(used) + " and asks for " + std::to_string(more) + " more");
}

tl::unexpected<Failure> Admission::over_quota(const Exceeded& exceeded, const std::string& text) {
  exceeded_ = exceeded;
  return fail_with(Errc::quota_exceeded, text);
}

}  // namespace agnocast::daemon
