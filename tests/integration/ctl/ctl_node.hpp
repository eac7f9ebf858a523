// SPDX-License-Identifier: Apache-2.0
//
// Clients for the tests of agnocast-ctl: a raw client that writes its region as an honest process
// does, and that a test then breaks.
#pragma once

#include <agnocast/abi/fingerprint.hpp>
#include <base/clock.hpp>
#include <region/views.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <optional>
#include <string>

namespace agnocast::test {

/// A raw client whose region the test can write. Domain 0 by default.
struct CtlNode {
  explicit CtlNode(const std::string& socket, std::uint64_t domain = 0,
                   const std::string& process = "wire_client")
      : wire(socket) {
    wire::Hello hello{};
    hello.fingerprint = abi::fingerprint();
    hello.domain = domain;
    hello.process_name = wire_name(process);
    Incoming answer = wire.ask(wire::Opcode::hello, hello);
    if (answer.opcode() != wire::Opcode::welcome) {
      ADD_FAILURE() << answer.refused_text();
      return;
    }
    region = std::move(
        Mapping::map(answer.fds[1].get(), std::uint64_t{1} << 30, Mapping::Access::read_write)
            .value());
  }
  wire::EndpointCreated create(wire::Opcode opcode, const std::string& topic, const abi::Qos& qos,
                               const std::string& node, const std::string& type) {
    auto body = WireClient::endpoint(topic, qos, type);
    body.node = wire_name(node);
    if (other_domain) body.domain = *other_domain + 1;
    const Incoming answer = wire.ask(opcode, body);
    EXPECT_EQ(answer.opcode(), wire::Opcode::endpoint_created) << answer.refused_text();
    return answer.as<wire::EndpointCreated>();
  }
  wire::EndpointCreated publisher(const std::string& topic, const abi::Qos& qos = {7},
                                  const std::string& node = "/ns/talker",
                                  const std::string& type = "test/msg/Type") {
    return create(wire::Opcode::create_publisher, topic, qos, node, type);
  }
  wire::EndpointCreated subscription(const std::string& topic, const abi::Qos& qos = {5},
                                     const std::string& node = "/listener",
                                     const std::string& type = "test/msg/Type") {
    if (!executor) doorbells = wire.open_wait_set().fds;
    executor = true;
    return create(wire::Opcode::create_subscription, topic, qos, node, type);
  }
  /// Commits as an honest publisher would: `count` messages, all still in the history.
  void commit(const wire::EndpointCreated& publisher, std::uint64_t count) {
    const region::PublisherWords<SharedMemory> words{region.base(), publisher.extent};
    for (std::uint64_t i = 0; i < count; ++i) {
      const std::uint64_t sequence = publisher.first_sequence + 1 + i;
      words.slot_address(i).store(window.base + 64 * i);
      words.slot_size(i).store(64);
      words.slot_id(i).store(sequence);
      words.order(sequence).store(abi::pack_entry(sequence, i));
      words.head().store(abi::pack_entry(sequence, i));
    }
  }
  /// Writes commit times of the first `count`, one period apart, the last one now; and bytes of
  /// each.
  void stamp(const wire::EndpointCreated& publisher, std::uint64_t count, std::uint64_t period_ns,
             std::uint64_t bytes) {
    const region::PublisherWords<SharedMemory> words{region.base(), publisher.extent};
    const std::uint64_t now = monotonic_ns();
    for (std::uint64_t i = 0; i < count; ++i)
      words.slot_stamp(i).store(now - (count - 1 - i) * period_ns);
    words.counter(offsetof(abi::PublisherEndpoint, published_bytes)).store(count * bytes);
  }
  void open_window() {
    window = wire.open_window(0).as<wire::WindowOpened>();
    auto& entry = reinterpret_cast<abi::ClientRegionHeader*>(region.base())->window[0];
    entry.base.store(window.base);
    entry.length.store(window.bytes);
    entry.frontier.store(std::uint64_t{1} << 20);
  }
  /// Links as an honest subscription that has taken `taken` messages and holds the first `held`.
  void link(const wire::EndpointCreated& own, const wire::EndpointCreated& publisher,
            std::uint64_t taken, std::uint64_t held) {
    const region::LinkWords<SharedMemory> line{region.base(), own.extent, publisher.index};
    line.cursor().store(publisher.first_sequence + 1 + taken);
    line.publisher_generation().store(publisher.generation);
    line.hold(0).store((std::uint64_t{1} << held) - 1);
  }

  WireClient wire;
  Mapping region;
  wire::WindowOpened window{};
  bool executor = false;
  std::optional<std::uint64_t> other_domain;  // of endpoints created from now on
  std::vector<UniqueFd> doorbells;
};

}  // namespace agnocast::test
