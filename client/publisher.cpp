// SPDX-License-Identifier: Apache-2.0
//
// The untyped half of Publisher: what its template calls.

#include <agnocast/publisher.hpp>
#include <client/context.hpp>
#include <client/qos_words.hpp>

#include <utility>

namespace agnocast::detail {

Result<std::shared_ptr<UntypedPublisher>> UntypedPublisher::create(
    const EndpointName& name, MessageType type, const QoS& qos, void (*destroy)(void*) noexcept) {
  if (Result<void> depth = check_depth(qos); !depth) return tl::unexpected<Failure>(depth.error());
  std::shared_ptr<UntypedPublisher> publisher(new UntypedPublisher(std::move(type), name.topic));
  EndpointRequest request;
  request.topic = name.topic;
  request.node = name.node;
  request.type = publisher->type_.name();
  request.layout_hash = publisher->type_.layout_hash();
  request.qos = to_abi(qos);
  auto endpoint = Context::instance().create_publisher(request, destroy);
  if (!endpoint) return tl::unexpected<Failure>(endpoint.error());
  publisher->endpoint_ = std::move(*endpoint);
  return publisher;
}

UntypedPublisher::~UntypedPublisher() {
  if (endpoint_ != nullptr) Context::instance().destroy(endpoint_);
}

Errc UntypedPublisher::publish(void* message, std::size_t bytes) noexcept {
  switch (endpoint_->publish(message, bytes)) {
    case dataplane::PublishOutcome::published:
      return Errc::ok;
    case dataplane::PublishOutcome::no_slot:
      return Errc::no_slot;
    case dataplane::PublishOutcome::would_block:
      return Errc::would_block;
  }
  return Errc::internal;
}

void UntypedPublisher::count_adoption(const Result<std::uint64_t>& adopted) noexcept {
  if (adopted) {
    endpoint_->count_adopted(*adopted);
  } else if (adopted.error().code == Errc::heap_exhausted) {
    endpoint_->count_heap_exhausted();
  }
}

SharedHeap UntypedPublisher::heap() const noexcept { return Context::instance().shared_heap(); }
std::size_t UntypedPublisher::subscription_count() const noexcept {
  return endpoint_->subscription_count();
}

}  // namespace agnocast::detail
