// SPDX-License-Identifier: Apache-2.0
//
// The parameters of an endpoint to be created: names, quality of service and properties of its
// type.
#pragma once

#include <agnocast/abi/words.hpp>
#include <client/endpoint/endpoint_events.hpp>
#include <client/process/library_thread.hpp>

#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>

namespace agnocast {

/// How a publisher's messages come into the shared heap.
struct HeapUse {
  bool by_allocator = false;  // they allocate there themselves, whichever library provides malloc
  bool by_copy = false;       // they may be copied there, so no hook is needed
};

/// The parameters of an endpoint. Names are fully qualified.
struct EndpointRequest {
  std::string_view topic;
  std::string_view type;
  std::string_view node;
  std::uint64_t layout_hash = 0;
  abi::Qos qos;
  std::uint64_t quota = 0;           // subscriptions: messages held at once, per publisher
  bool quota_or_less = false;        // for publishers of other users a smaller number is accepted
  bool depth_per_publisher = false;  // subscriptions
  HeapUse heap_use;                  // publishers
  std::uint64_t message_bytes = 0;   // sizeof the message object; 0 = any
  std::uint64_t message_alignment = 1;
  std::uint64_t persistent_id = 0;             // 0: a new one
  bool announces_persistent_id_later = false;  // publishers: see EndpointName
  std::optional<std::uint64_t> domain;         // none: that of the process
  SignalMask signals;                          // for destructors of messages
};

/// What an endpoint of a new session takes from the one that it continues.
struct Continued {
  std::uint64_t persistent_id = 0;  // 0: it continues none
  std::shared_ptr<EndpointEvents> events;
};

}  // namespace agnocast
