// SPDX-License-Identifier: Apache-2.0

#include <client/process/steps.hpp>
#include <client/session/context.hpp>
#include <client/session/creations.hpp>

#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Opcode;

namespace {

Result<wire::CreateEndpoint> describe(const EndpointRequest& request,
                                      std::uint64_t wait_set) noexcept {
  wire::CreateEndpoint body{};
  body.qos = abi::pack_qos(request.qos);
  body.layout_hash = request.layout_hash;
  body.wait_set = wait_set;
  body.quota = request.quota | (request.quota_or_less ? wire::quota_or_less : 0);
  body.domain = request.domain ? *request.domain + 1 : 0;
  if (!write_name(body.topic, request.topic))
    return fail(Errc::invalid_name, "a topic name of more than 255 characters");
  if (!write_name(body.type, request.type))
    return fail(Errc::invalid_name, "a type name of more than 255 characters");
  if (!write_name(body.node, request.node))
    return fail(Errc::invalid_name, "a node name of more than 255 characters");
  return body;
}

}  // namespace

/// Returns the id of the continued endpoint, or a new one that no endpoint of any session has.
std::uint64_t Creations::persistent_id_of(const Continued& continued,
                                          const wire::EndpointCreated& made,
                                          Kind kind) const noexcept {
  std::uint64_t sum = continued.persistent_id;
  if (sum == 0) {
    for (const std::uint64_t part :
         {registration_.incarnation(), registration_.client().first, std::uint64_t{made.topic},
          made.index, made.generation, static_cast<std::uint64_t>(kind)}) {
      sum = (sum ^ part) * 0x9e3779b97f4a7c15;
      sum ^= sum >> 29;
    }
  }
  return sum != 0 ? sum : 1;
}

Result<std::shared_ptr<PublisherEndpoint>> Creations::make_publisher(
    const EndpointRequest& request, const detail::MessageEnd& end_message,
    const Continued& continued, bool (*make_room)() noexcept) {
  const Result<wire::CreateEndpoint> body = describe(request, 0);
  if (!body) return tl::unexpected<Failure>(body.error());
  std::shared_ptr<PublisherEndpoint> publisher;
  Result<void> created = registration_.connection().request(
      Opcode::create_publisher, *body,
      [&](Incoming& packet) -> Result<void> {
        wire::EndpointCreated made{};
        if (!packet.read(made) || made.topic >= abi::topic_count_max ||
            made.index >= abi::publisher_count_max) {
          return fail(Errc::protocol_violation, "a new publisher");
        }
        if (Result<void> opened = registration_.open_extents(made, abi::publisher_extent_bytes);
            !opened)
          return opened;
        const PublisherEndpoint::Core::Identity core{
            {registration_.board().base(), abi::topic_offset(made.topic)},
            {registration_.region_base(), made.extent},
            made.index,
            made.generation,
            made.first_sequence,
            request.qos,
            made.slot_count,
            PublisherEndpoint::deferred_limit,
            registration_.client().first};
        publisher = std::make_shared<PublisherEndpoint>(PublisherEndpoint::Identity{
            core, made.topic, end_message, registration_.waker(), continued.events, session_,
            persistent_id_of(continued, made, Kind::publisher),
            request.announces_persistent_id_later && continued.events == nullptr, make_room,
            request.signals});
        endpoints_.add(publisher);
        return {};
      },
      [this](Incoming& packet) { return adopt_late(Kind::publisher, packet); });
  if (!created) return tl::unexpected<Failure>(created.error());
  return publisher;
}

Result<std::shared_ptr<SubscriptionEndpoint>> Creations::make_subscription(
    const EndpointRequest& request, const std::shared_ptr<WaitSet>& wait_set,
    const Continued& continued) {
  const Result<wire::CreateEndpoint> body = describe(request, *wait_set->index_in(session_));
  if (!body) return tl::unexpected<Failure>(body.error());
  std::shared_ptr<SubscriptionEndpoint> subscription;
  Result<void> created = registration_.connection().request(
      Opcode::create_subscription, *body,
      [&](Incoming& packet) -> Result<void> {
        wire::EndpointCreated made{};
        if (!packet.read(made) || made.topic >= abi::topic_count_max ||
            made.index >= abi::subscription_count_max) {
          return fail(Errc::protocol_violation, "a new subscription");
        }
        // Further link blocks when a publisher of theirs is announced.
        if (Result<void> opened =
                registration_.open_extents(made, abi::subscription_extent_bytes(1));
            !opened)
          return opened;
        subscription = std::make_shared<SubscriptionEndpoint>(
            SubscriptionEndpoint::Identity{
                {registration_.board().base(), abi::topic_offset(made.topic)},
                made.topic,
                made.index,
                made.generation,
                registration_.region_base(),
                made.extent,
                request.qos,
                request.quota,
                request.depth_per_publisher,
                request.message_bytes,
                request.message_alignment,
                registration_.waker(),
                continued.events,
                session_,
                persistent_id_of(continued, made, Kind::subscription)},
            wait_set);
        endpoints_.add(subscription);
        return {};
      },
      [this](Incoming& packet) { return adopt_late(Kind::subscription, packet); });
  if (!created) return tl::unexpected<Failure>(created.error());
  return subscription;
}

Result<std::unique_ptr<WaitSet::Place>> Creations::open_wait_set(std::uint64_t wait_set,
                                                                 bool again) {
  wire::WaitSetRequest request{};
  request.wait_set = wait_set;
  std::unique_ptr<WaitSet::Place> place;
  Result<void> opened = registration_.connection().request(
      Opcode::open_wait_set, request,
      [&](Incoming& packet) -> Result<void> {
        wire::Done answer{};
        if (Result<void> read =
                packet.read_as(Opcode::wait_set_opened, answer, 2, "the answer with a wait set");
            !read)
          return read;
        const auto fds = packet.packet.fds();
        AGNOCAST_CRASH_POINT(C_wait_set);
        place = std::make_unique<WaitSet::Place>(
            registration_.region_base(), wait_set,
            DoorbellReceiver(std::move(fds[0]), std::move(fds[1])));
        return {};
      },
      nullptr, again);
  if (!opened) return tl::unexpected<Failure>(opened.error());
  return place;
}

// Handles the answer to a creation whose caller has given up.
Result<void> Creations::adopt_late(Kind kind, Incoming& packet) {
  wire::EndpointCreated made{};
  if (packet.read(made))
    departures_.adopt_unclaimed(kind, {made.topic, made.index}, made.generation, false);
  return {};
}

}  // namespace agnocast
